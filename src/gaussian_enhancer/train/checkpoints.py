"""When a training writes the checkpoint that it resumes from."""

from typing import Any

from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint


class TrainingCheckpoint(ModelCheckpoint):
    """Lightning's checkpoint every so many steps, but none from which a resumed training would end otherwise.

    - The one that is due with the last batch of an epoch is written after the epoch's validation. Lightning would write
      it before, and a training that resumed there would not validate.
    - None is written after the last step. A training that resumed there would make no step, for which Lightning calls
      no callback: the moving average of the weights would not take their place.
    """

    _due = False

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Write a checkpoint where one is due, within an epoch."""
        if 0 <= trainer.max_steps <= trainer.global_step:
            return
        if trainer.fit_loop.epoch_loop.batch_progress.is_last_batch:
            self._due = trainer.global_step % self._every_n_train_steps == 0
            return
        super().on_train_batch_end(trainer, pl_module, outputs, batch, batch_idx)

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the checkpoint that was due with the epoch's last batch."""
        if self._due:
            self._due = False
            loop = trainer.fit_loop.epoch_loop
            loop._batches_that_stepped -= 1  # on resuming, Lightning adds the batch that it takes to be unfinished
            super().on_train_batch_end(trainer, pl_module, None, None, 0)
            loop._batches_that_stepped += 1
        super().on_train_epoch_end(trainer, pl_module)
