"""How much of a training's time its steps wait for data."""

import time
from collections.abc import Callable
from typing import Any

from lightning import Callback, LightningModule, Trainer


class Waiting(Callback):
    """Measures the share of the wall-clock time that the training step waited for its next batch.

    share = waited / (waited + worked), where a step works from ``on_train_batch_start`` to ``on_train_batch_end`` and
    waits from there to the next start. What other callbacks do between two steps is waiting too, so the share is an
    upper bound; validation between two steps is left out. The wait for the first batch of an epoch, in which workers
    start, is counted on its own. The counts are kept in checkpoints, so that they are those of the whole training.

    Args:
        clock: seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.clock = clock
        self.waited = self.worked = self.first = 0.0
        self._mark = clock()
        self._fresh = True

    @property
    def share(self) -> float:
        """Share of the time that steps waited, first batches of epochs left out, [0, 1]."""
        return self.waited / max(1e-9, self.waited + self.worked)

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """A training that goes on in the middle of an epoch has a first batch too."""
        self._mark, self._fresh = self.clock(), True

    def on_train_epoch_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """The next wait is for an epoch's first batch."""
        self._mark, self._fresh = self.clock(), True

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Whatever time has passed since the last step was not spent on waiting."""
        self._mark = self.clock()

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        """The wait is over."""
        now = self.clock()
        if self._fresh:
            self.first += now - self._mark
        else:
            self.waited += now - self._mark
        self._mark, self._fresh = now, False

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """The step is done; log the share so far as ``time/waiting``, and seconds so far as ``time/seconds``."""
        now = self.clock()
        self.worked += now - self._mark
        self._mark = now
        so_far = {"time/waiting": self.share, "time/seconds": self.first + self.waited + self.worked}
        pl_module.log_dict(so_far, on_step=True, on_epoch=False, batch_size=1)

    def state_dict(self) -> dict[str, float]:
        """The counts in seconds."""
        return {"waited": self.waited, "worked": self.worked, "first": self.first}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on counting."""
        self.waited, self.worked, self.first = (float(state_dict[key]) for key in ("waited", "worked", "first"))
