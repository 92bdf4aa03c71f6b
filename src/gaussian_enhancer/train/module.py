"""Lightning module that trains and validates a network."""

from dataclasses import dataclass
from typing import Any

import torch
import torch.nn.functional as F
from lightning import LightningModule
from torch import Tensor
from torchmetrics import MetricCollection

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.loss.weighted_sum import WeightedLoss
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.train.non_finite import BAD_SHARE, NonFiniteFilter, finite_samples, zero_samples
from gaussian_enhancer.train.optimizers import MakeOptimizer, MakeScheduler, decayed_groups, optimizer_configuration
from gaussian_enhancer.train.share import gather
from gaussian_enhancer.types import Batch, quantise_8_bit, single_precision


@dataclass(frozen=True)
class ValidationMetrics:
    """Validation metrics of one view.

    Args:
        position: position of the view among all validation views.
        name: set and view.
        gains: gain over the raw render, by metric.
    """

    position: int
    name: str
    gains: dict[str, float]


class EnhancerModule(LightningModule):
    """Trains and validates a network. The callback ``WeightAveraging`` validates and keeps the averaged weights.

    Several processes that share a training log the same values as one process: means over all crops and views.

    Args:
        network: maps views to enhanced images.
        loss: the training loss.
        metrics: gains over the raw render, updated with enhanced image, render and photo (`train.metrics.gains`).
        optimizer: makes the optimizer from parameter groups.
        lr_scheduler: makes the learning-rate scheduler from the optimizer; None keeps the learning rate constant.
        coarse: weight of the loss at each coarser scale of a multi-scale network (NeRFLiX++'s intermediate
            supervision).
        bad_share: share of the crops that may be dropped because they are not finite; above it the training fails.

    Raises:
        InputError: ``bad_share`` is not in [0, 1].
    """

    def __init__(
        self,
        network: Network,
        loss: WeightedLoss,
        metrics: MetricCollection,
        optimizer: MakeOptimizer,
        lr_scheduler: MakeScheduler | None = None,
        coarse: float = 0.1,
        bad_share: float = BAD_SHARE,
    ) -> None:
        super().__init__()
        self.network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.loss, self.metrics = loss, metrics
        self.optimizer, self.lr_scheduler, self.coarse = optimizer, lr_scheduler, coarse
        self.view_metrics: list[ValidationMetrics] = []
        self.non_finite = NonFiniteFilter(bad_share)
        self.crops = 0  # crops per step in this process

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """Loss of a batch of crops.

        Raises:
            InputError: too many crops were dropped, or the weights are no longer finite.
        """
        total, terms = self.batch_loss(batch)
        size = len(batch.names)
        self.log("train/total", total, prog_bar=True, batch_size=size, sync_dist=True)
        self.log_dict({f"train/{name}": value for name, value in terms.items()}, batch_size=size, sync_dist=True)
        return total

    def batch_loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Loss of a batch, and the means of its terms.

        Samples whose inputs or outputs are not finite are dropped: their weight is 0, but the batch keeps its size, so
        that several processes stay synchronised.

        Raises:
            InputError: see `training_step`.
        """
        finite = finite_samples(batch)
        self.crops = len(finite)
        if bool(finite.all()):
            images = self.network.stages(batch.views)
            finite = torch.stack([image.detach().flatten(1).float().sum(1).isfinite() for image in images]).all(0)
            if bool(finite.all()):
                return self._loss_at_all_scales(images, batch.views.render, batch.photo)
        self.non_finite.add(
            [name for name, is_finite in zip(batch.names, finite.tolist(), strict=True) if not is_finite]
        )
        self.non_finite.refuse_many((self.global_step + 1) * self.crops)
        batch = zero_samples(batch, finite)
        images = self.network.stages(batch.views)
        if not all(bool(image.isfinite().all()) for image in images):
            received = f"has weights that are not finite at step {self.global_step}"
            raise InputError("training", received, "lower optimizer.lr, or warm it up for longer")
        if not bool(finite.any()):
            zero = images[-1].detach().new_zeros(())
            total = torch.stack([0.0 * image.float().sum() for image in images]).sum()
            return total, dict.fromkeys(self.loss.terms, zero)
        finite_images = tuple(image[finite] for image in images)
        total, terms = self._loss_at_all_scales(finite_images, batch.views.render[finite], batch.photo[finite])
        return total * finite.float().mean(), terms

    def _loss_at_all_scales(
        self, images: tuple[Tensor, ...], renders: Tensor, photos: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Loss of enhanced images at all scales, coarse to fine, given renders and photos."""
        *coarser, enhanced = images
        with torch.autocast(self.device.type, enabled=False):
            enlarged_render = upsample_bicubic(renders, self.network.scale).clamp(0, 1)
            total, terms = self.loss(single_precision(enhanced), photos, enlarged_render)
            for image in coarser:
                photo, render = (
                    F.adaptive_avg_pool2d(full_size, (image.shape[-2], image.shape[-1]))
                    for full_size in (photos, enlarged_render)
                )
                total = total + self.coarse * self.loss(single_precision(image), photo, render)[0]
        return total, terms

    def on_train_end(self) -> None:
        """Fail if all processes together have dropped too many crops."""
        self.non_finite.refuse_many_of_all(self.global_step * self.crops * self.trainer.world_size)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Store the counts of dropped samples, if any; without any, the entry is left out, as in older checkpoints."""
        counts = self.non_finite.dropped_by_all()
        if counts:
            checkpoint["dropped"] = counts

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Restore the counts of dropped samples; the first process takes those of all processes."""
        if self.trainer.is_global_zero:
            self.non_finite.counts = dict(checkpoint.get("dropped", {}))

    def on_validation_epoch_start(self) -> None:
        """Clear the results of the last validation."""
        self.view_metrics = []

    def validation_step(self, batch: Batch, index: int) -> dict[str, Any]:
        """Measure the gain over the raw render on a whole image, both quantised to 8 bits.

        Returns:
            Position of the view, and the enhanced image.
        """
        enhanced = quantise_8_bit(self.network(batch.views).float())
        raw = quantise_8_bit(upsample_bicubic(batch.views.render, self.network.scale))
        with torch.autocast(self.device.type, enabled=False):
            gains = self.metrics(enhanced, raw, batch.photo)
        self.log_dict(self.metrics, on_step=False, on_epoch=True, prog_bar=True, batch_size=1)
        position = index * self.trainer.world_size + self.trainer.global_rank
        values = {name.removeprefix("gain/"): float(value) for name, value in gains.items()}
        self.view_metrics.append(ValidationMetrics(position, batch.names[0], values))
        return {"position": position, "enhanced": enhanced}

    def on_validation_epoch_end(self) -> None:
        """Gather the results of the views from all processes, in the order of the views."""
        self.view_metrics = sorted(gather(self.view_metrics), key=lambda metrics: metrics.position)

    def configure_optimizers(self) -> Any:
        """Optimizer of the network's parameters, with weight decay on the weights of convolutions only."""
        groups = decayed_groups(self.network.parameters())
        return optimizer_configuration(groups, self.optimizer, self.lr_scheduler, monitor="gain/psnr")
