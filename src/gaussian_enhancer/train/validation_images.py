"""Logging of validation results beyond scalars: a table of all views' gains, and a few images.

Axes: h height, w width.
"""

from collections.abc import Sequence
from operator import itemgetter
from typing import Any

import torch
from jaxtyping import UInt8
from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import Logger, TensorBoardLogger, WandbLogger
from torch import Tensor

from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.scene.splits import evenly_spaced
from gaussian_enhancer.train.module import ValidationMetrics
from gaussian_enhancer.train.share import gather
from gaussian_enhancer.types import Batch, quantise_8_bit

IMAGE_LOGGERS = (WandbLogger, TensorBoardLogger)
"""Loggers that accept images; wandb's accepts tables as well."""
IMAGE_COUNT = 4
"""Number of views whose images are logged, spread evenly."""


class ValidationImages(Callback):
    """Logs tables and images after each validation.

    Args:
        loggers: the trainer's loggers.
    """

    def __init__(self, loggers: Sequence[Logger]) -> None:
        self.loggers = [logger for logger in loggers if isinstance(logger, IMAGE_LOGGERS)]
        self.pending_images: list[tuple[int, str, Tensor]] = []

    def on_validation_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Clear the images of the last validation."""
        self.pending_images = []

    def on_validation_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Batch, batch_idx: int, *_: int
    ) -> None:
        """Keep the images of the view if it is one of those to log.

        Args:
            trainer: the trainer.
            pl_module: the module.
            outputs: position among all views, and the enhanced image.
            batch: a batch of one whole image.
            batch_idx: unused.
            *_: unused.
        """
        position, enhanced = outputs["position"], outputs["enhanced"]
        views = len(trainer.val_dataloaders.dataset)  # type: ignore[union-attr]
        if self.loggers and position in evenly_spaced(range(views), IMAGE_COUNT):
            raw = quantise_8_bit(upsample_bicubic(batch.views.render, pl_module.network.scale))  # type: ignore[arg-type,union-attr]
            self.pending_images.append((position, batch.names[0], side_by_side(raw[0], enhanced[0], batch.photo[0])))

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Log the table and the kept images, in the first process only."""
        if not self.loggers:
            return
        gathered = sorted(gather(self.pending_images), key=itemgetter(0))
        self.pending_images = []
        view_metrics: list[ValidationMetrics] = pl_module.view_metrics  # type: ignore[assignment]
        if not trainer.is_global_zero or trainer.sanity_checking or not view_metrics:
            return
        names, images = [name for _, name, _ in gathered], [image for _, _, image in gathered]
        for logger in self.loggers:
            if isinstance(logger, WandbLogger):
                metrics = sorted(view_metrics[0].gains)
                rows = [[view.name, *(view.gains[metric] for metric in metrics)] for view in view_metrics]
                columns = ["view", *(f"gain/{metric}" for metric in metrics)]
                logger.log_table("validation/views", columns, rows, step=trainer.global_step)
                arrays = [image.permute(1, 2, 0).numpy() for image in images]
                logger.log_image("validation/images", arrays, step=trainer.global_step, caption=names)
            elif isinstance(logger, TensorBoardLogger):
                for name, image in zip(names, images, strict=True):
                    logger.experiment.add_image(f"validation/{name}", image, trainer.global_step)


def side_by_side(*images: Tensor) -> UInt8[Tensor, "3 h w"]:
    """Place images in [0, 1] of equal height side by side, in 8 bits: render, enhanced, photo."""
    row = torch.cat([image.detach().float().cpu() for image in images], dim=-1)
    return (row.clamp(0, 1) * 255).round().to(torch.uint8)
