"""Checkpoint callback that writes checkpoints only where a resumed training gives the same result."""

from typing import Any

from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint


class TrainingCheckpoint(ModelCheckpoint):
    """Lightning's periodic checkpoint, timed so that a resumed training gives the same result as an uninterrupted one.

    - A checkpoint due after a batch is written before the next batch begins. Lightning would write it before the
      batch's metrics are logged, and a training resumed from it would not log them.
    - A checkpoint due after the last batch of an epoch is written after the epoch's validation. A training resumed
      from an earlier checkpoint would skip this validation.
    - No checkpoint is written after the last step. A training resumed from it would make no step, and Lightning would
      then call no callback: the weights would not be replaced by their moving average.
    """

    _due = False

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Note that a checkpoint is due."""
        is_last_step = 0 <= trainer.max_steps <= trainer.global_step
        self._due = not is_last_step and trainer.global_step % self._every_n_train_steps == 0

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        """Write the checkpoint that became due after the previous batch."""
        if self._due:
            progress = trainer.fit_loop.epoch_loop.batch_progress
            for counts in (progress.total, progress.current):  # the checkpoint must not count the new batch
                counts.ready -= 1
            self._write(trainer, pl_module)
            for counts in (progress.total, progress.current):
                counts.ready += 1

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the checkpoint that became due after the epoch's last batch."""
        if self._due:
            loop = trainer.fit_loop.epoch_loop
            loop._batches_that_stepped -= 1  # on resuming, Lightning adds 1 for an unfinished batch
            self._write(trainer, pl_module)
            loop._batches_that_stepped += 1
        super().on_train_epoch_end(trainer, pl_module)

    def _write(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._due = False
        super().on_train_batch_end(trainer, pl_module, None, None, 0)
