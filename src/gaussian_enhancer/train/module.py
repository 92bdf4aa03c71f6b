"""The thin layer between a network and Lightning."""

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
import torch.nn.functional as F
from lightning import LightningModule
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.loss.weighted_sum import WeightedLoss
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.network.pyramid import upsampled
from gaussian_enhancer.ssim import ssim_map
from gaussian_enhancer.train.ema import follow
from gaussian_enhancer.train.non_finite import BAD_SHARE, NonFiniteFilter, emptied, finite_samples
from gaussian_enhancer.train.share import gathered
from gaussian_enhancer.types import Batch, precise, quantised


@dataclass(frozen=True)
class OptimiserConfig:
    """AdamW with linear warm-up and a cosine down to zero.

    Args:
        rate: largest learning rate.
        decay: weight decay of AdamW.
        warmup: steps of rising rate.
        ema: decay of the running mean of the weights, which is what is kept; 0 keeps the last.
    """

    lr: float = 8e-4
    decay: float = 1e-4
    warmup: int = 200
    ema: float = 0.999

    def factor(self, step: int, steps: int) -> float:
        """Share of the largest learning rate at a step."""
        rise = min(1.0, (step + 1) / max(1, self.warmup))
        return rise * 0.5 * (1 + math.cos(math.pi * min(1.0, step / max(1, steps))))


@dataclass(frozen=True)
class ValidationMetrics:
    """What a validation found of one view.

    Args:
        place: of the view among all.
        name: set and view.
        gains: over the raw render, by metric.
    """

    place: int
    name: str
    gains: dict[str, float]


class EnhancerModule(LightningModule):
    """Trains a network; keeps the running mean of its weights as ``ema`` and validates with that.

    Several processes that share a training log what one would: means over all their crops and views.

    Args:
        network: maps views to enhanced images.
        loss: what is minimised.
        metrics: figures of enhanced image against photo by name; their gain over the raw render is logged.
        optimiser: how.
        steps: length of the training, for the schedule.
        coarse: weight of the loss at each coarser scale of a network that has several (NeRFLiX++'s
            intermediate supervision).
        bad_share: share of the crops that may be dropped for not being finite, before the training fails.

    Raises:
        InputError: the share is none.
    """

    def __init__(
        self,
        network: Network,
        loss: WeightedLoss,
        metrics: Mapping[str, Any],
        optimiser: OptimiserConfig,
        steps: int,
        coarse: float = 0.1,
        bad_share: float = BAD_SHARE,
    ) -> None:
        super().__init__()
        self.network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.ema = copy.deepcopy(network).requires_grad_(False)
        self.loss, self.metrics, self.optimiser, self.steps = loss, dict(metrics), optimiser, steps
        self.coarse = coarse
        self.judged: list[ValidationMetrics] = []
        self.non_finite = NonFiniteFilter(bad_share)
        self.crops = 0  # of a step, in this process

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """Loss of a batch of crops.

        Raises:
            InputError: too many crops were dropped, or the weights are no longer finite.
        """
        total, parts = self.batch_loss(batch)
        size = len(batch.names)
        self.log("train/total", total, prog_bar=True, batch_size=size, sync_dist=True)
        self.log_dict({f"train/{name}": value for name, value in parts.items()}, batch_size=size, sync_dist=True)
        return total

    def batch_loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Objective of a batch, and the means of its terms.

        Samples that are not finite, before the network or after it, are dropped: they weigh nothing, and the batch
        keeps its size, so that several processes stay in step.

        Raises:
            InputError: see `training_step`.
        """
        kept = finite_samples(batch)
        self.crops = len(kept)
        if bool(kept.all()):
            images = self.network.stages(batch.views)
            kept = torch.stack([image.detach().flatten(1).float().sum(1).isfinite() for image in images]).all(0)
            if bool(kept.all()):
                return self._loss_at_all_scales(images, batch.views.render, batch.photo)
        self.non_finite.add([name for name, good in zip(batch.names, kept.tolist(), strict=True) if not good])
        self.non_finite.refuse_many((self.global_step + 1) * self.crops)
        batch = emptied(batch, kept)
        images = self.network.stages(batch.views)
        if not all(bool(image.isfinite().all()) for image in images):
            received = f"has weights that are not finite at step {self.global_step}"
            raise InputError("training", received, "lower optimiser.rate, or raise optimiser.warmup")
        if not bool(kept.any()):
            nothing = images[-1].detach().new_zeros(())
            return torch.stack([0.0 * image.float().sum() for image in images]).sum(), dict.fromkeys(
                self.loss.terms, nothing
            )
        chosen = tuple(image[kept] for image in images)
        total, parts = self._loss_at_all_scales(chosen, batch.views.render[kept], batch.photo[kept])
        return total * kept.float().mean(), parts

    def _loss_at_all_scales(
        self, images: tuple[Tensor, ...], drawn: Tensor, truth: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss of enhanced images at all scales, coarse to fine, given renders and photos."""
        *coarser, enhanced = images
        with torch.autocast(self.device.type, enabled=False):
            start = upsampled(drawn, self.network.scale).clamp(0, 1)
            total, parts = self.loss(precise(enhanced), truth, start)
            for image in coarser:
                photo, render = (
                    F.adaptive_avg_pool2d(full, (image.shape[-2], image.shape[-1])) for full in (truth, start)
                )
                total = total + self.coarse * self.loss(precise(image), photo, render)[0]
        return total, parts

    def on_train_end(self) -> None:
        """Judge how many crops were dropped, by all processes together."""
        self.non_finite.refuse_many_of_all(self.global_step * self.crops * self.trainer.world_size)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep what was dropped; a checkpoint without such samples is what it was before they were counted."""
        counts = self.non_finite.of_all()
        if counts:
            checkpoint["dropped"] = counts

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Go on counting; the first process takes what all had dropped."""
        if self.trainer.is_global_zero:
            self.non_finite.counts = dict(checkpoint.get("dropped", {}))

    def optimizer_step(self, *arguments: Any, **named: Any) -> None:
        """Step, and move the running mean towards the weights before a checkpoint can be written."""
        super().optimizer_step(*arguments, **named)
        follow(self.ema, self.network, self.optimiser.ema, self.global_step + 1)

    def on_validation_epoch_start(self) -> None:
        """Forget the last validation."""
        self.judged = []

    def validation_step(self, batch: Batch, index: int) -> dict[str, Any]:
        """Gain over the raw render on a whole image, both quantised to 8 bit; returns its place and image."""
        enhanced = quantised(self.ema(batch.views).float())
        raw = quantised(upsampled(batch.views.render, self.network.scale))
        with torch.autocast(self.device.type, enabled=False):
            gains = {
                name: float(metric(enhanced, batch.photo) - metric(raw, batch.photo))
                for name, metric in self.metrics.items()
            }
        place = index * self.trainer.world_size + self.trainer.global_rank
        self.judged.append(ValidationMetrics(place, batch.names[0], gains))
        return {"place": place, "enhanced": enhanced}

    def on_validation_epoch_end(self) -> None:
        """Log each metric's mean gain over all views, however many each process had."""
        self.judged = sorted(gathered(self.judged), key=lambda one: one.place)
        for name in self.metrics if self.judged else ():
            mean = math.fsum(one.gains[name] for one in self.judged) / len(self.judged)
            self.log(f"gain/{name}", mean, prog_bar=True, rank_zero_only=False)

    def configure_optimizers(self) -> Any:
        """AdamW on the network's parameters; convolutions' weights alone decay."""
        parameters = [p for p in self.network.parameters() if p.requires_grad]
        groups = [
            {"params": [p for p in parameters if p.dim() == 4], "weight_decay": self.optimiser.decay},
            {"params": [p for p in parameters if p.dim() != 4], "weight_decay": 0.0},
        ]
        adam = torch.optim.AdamW(groups, lr=self.optimiser.lr, betas=(0.9, 0.99))
        schedule = torch.optim.lr_scheduler.LambdaLR(adam, lambda step: self.optimiser.factor(step, self.steps))
        return {"optimizer": adam, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


def psnr(enhanced: Tensor, photo: Tensor) -> Tensor:
    """Peak signal-to-noise ratio in dB of images in [0, 1], 100 at most."""
    from torchmetrics.functional.image import peak_signal_noise_ratio

    return peak_signal_noise_ratio(enhanced, photo, data_range=1.0).clamp_max(100)


def ssim(enhanced: Tensor, photo: Tensor) -> Tensor:
    """Structural similarity, mean over all pixels (`ssim_map`)."""
    return ssim_map(enhanced, photo).mean()
