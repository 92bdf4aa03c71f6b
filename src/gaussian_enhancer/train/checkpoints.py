"""When a training writes the checkpoint that it resumes from."""

from typing import Any

from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint


class TrainingCheckpoint(ModelCheckpoint):
    """Lightning's checkpoint every so many steps, but none from which a resumed training would end otherwise.

    - The one that is due with a batch is written before the next batch begins. Lightning would write it before the
      batch's metrics are logged, and a training that resumed there would not log them.
    - The one that is due with the last batch of an epoch is written after the epoch's validation. A training that
      resumed before it would not validate.
    - None is written after the last step. A training that resumed there would make no step, for which Lightning calls
      no callback: the moving average of the weights would not take their place.
    """

    _due = False

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Note that a checkpoint is due."""
        ended = 0 <= trainer.max_steps <= trainer.global_step
        self._due = not ended and trainer.global_step % self._every_n_train_steps == 0

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        """Write the checkpoint that was due with the batch before."""
        if self._due:
            progress = trainer.fit_loop.epoch_loop.batch_progress
            for counted in (progress.total, progress.current):  # the batch that begins is not a part of it
                counted.ready -= 1
            self._write(trainer, pl_module)
            for counted in (progress.total, progress.current):
                counted.ready += 1

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the checkpoint that was due with the epoch's last batch."""
        if self._due:
            loop = trainer.fit_loop.epoch_loop
            loop._batches_that_stepped -= 1  # on resuming, Lightning adds the batch that it takes to be unfinished
            self._write(trainer, pl_module)
            loop._batches_that_stepped += 1
        super().on_train_epoch_end(trainer, pl_module)

    def _write(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._due = False
        super().on_train_batch_end(trainer, pl_module, None, None, 0)
