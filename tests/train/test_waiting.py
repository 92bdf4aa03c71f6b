import time

import pytest
import torch
from lightning import LightningModule, Trainer
from torch.utils.data import DataLoader, Dataset

from gaussian_enhancer.train.waiting import Waiting


class Rows(Dataset):
    def __init__(self, pause: float) -> None:
        self.pause = pause

    def __len__(self) -> int:
        return 8

    def __getitem__(self, index: int) -> torch.Tensor:
        time.sleep(self.pause)
        return torch.ones(1)


class Slow(LightningModule):
    """Steps of a known length."""

    def __init__(self, pause: float) -> None:
        super().__init__()
        self.weight, self.pause, self.logged = torch.nn.Parameter(torch.ones(1)), pause, []

    def training_step(self, batch, index):
        time.sleep(self.pause)
        return (self.weight * batch).sum()

    def on_train_batch_end(self, outputs, batch, index):
        self.logged.append(float(self.trainer.callback_metrics["time/waiting"]))

    def validation_step(self, batch, index):
        time.sleep(0.2)

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), lr=0.1)


def trained(waiting: Waiting, loading: float, stepping: float, validation=None, **options) -> Slow:
    module = Slow(stepping)
    trainer = Trainer(
        accelerator="cpu",
        callbacks=[waiting],
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        num_sanity_val_steps=0,
        **{"max_epochs": 1, **options},
    )
    trainer.fit(module, DataLoader(Rows(loading)), validation)
    return module


def test_slow_data_are_told_from_slow_steps():
    starved, fed = Waiting(), Waiting()
    module = trained(starved, loading=0.05, stepping=0.0)
    trained(fed, loading=0.0, stepping=0.05)
    assert starved.share > 0.6
    assert fed.share < 0.4
    assert starved.waited >= 7 * 0.05
    assert fed.worked >= 8 * 0.05
    assert module.logged[-1] == pytest.approx(starved.share, abs=1e-5)


def test_first_batches_of_epochs_are_counted_alone():
    waiting = Waiting()
    trained(waiting, loading=0.1, stepping=0.0, max_epochs=3, limit_train_batches=1)
    assert waiting.first >= 3 * 0.1
    assert waiting.waited == 0


def test_validation_is_no_waiting():
    waiting = Waiting()
    trained(waiting, 0.0, 0.0, DataLoader(Rows(0.0)), val_check_interval=4, limit_val_batches=2)
    assert waiting.waited < 0.4


def test_the_share_is_that_of_the_clock():
    now = iter([0.0, 1.0, 3.0, 4.0, 5.0, 8.0])  # made, epoch, batch (2 s), end (1 s), batch (1 s), end (3 s)
    waiting = Waiting(clock=lambda: next(now))
    module, trainer = Slow(0.0), Trainer(accelerator="cpu", logger=False, enable_checkpointing=False)
    logged: list[tuple[str, float]] = []
    module.log = lambda name, value, **kwargs: logged.append((name, float(value)))
    waiting.on_train_epoch_start(trainer, module)
    for index in range(2):
        waiting.on_train_batch_start(trainer, module, None, index)
        waiting.on_train_batch_end(trainer, module, None, None, index)
    assert (waiting.first, waiting.waited, waiting.worked) == (2.0, 1.0, 4.0)
    assert waiting.share == pytest.approx(0.2)
    assert [value for name, value in logged if name == "time/seconds"] == [3.0, 7.0]
    resumed = Waiting()
    resumed.load_state_dict(waiting.state_dict())
    assert resumed.share == waiting.share
    assert resumed.first == waiting.first
