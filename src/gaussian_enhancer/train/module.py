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

from gaussian_enhancer.enhance.network import Network
from gaussian_enhancer.enhance.pyramid import enlarged
from gaussian_enhancer.objective.objective import Objective
from gaussian_enhancer.train.average import follow
from gaussian_enhancer.train.share import gathered
from gaussian_enhancer.types import Batch, quantised


@dataclass(frozen=True)
class Optimiser:
    """AdamW with linear warm-up and a cosine down to zero.

    Args:
        rate: largest learning rate.
        decay: weight decay of AdamW.
        warmup: steps of rising rate.
        average: decay of the running mean of the weights, which is what is kept; 0 keeps the last.
    """

    rate: float = 8e-4
    decay: float = 1e-4
    warmup: int = 200
    average: float = 0.999

    def factor(self, step: int, steps: int) -> float:
        """Share of the largest learning rate at a step."""
        rise = min(1.0, (step + 1) / max(1, self.warmup))
        return rise * 0.5 * (1 + math.cos(math.pi * min(1.0, step / max(1, steps))))


@dataclass(frozen=True)
class Judged:
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
    """Trains a network; keeps the running mean of its weights as ``average`` and validates with that.

    Several processes that share a training log what one would: means over all their crops and views.

    Args:
        network: maps views to enhanced images.
        objective: what is minimised.
        metrics: figures of enhanced image against photo by name; their gain over the raw render is logged.
        optimiser: how.
        steps: length of the training, for the schedule.
        coarse: weight of the objective at each coarser scale of a network that has several (NeRFLiX++'s
            intermediate supervision).
    """

    def __init__(
        self,
        network: Network,
        objective: Objective,
        metrics: Mapping[str, Any],
        optimiser: Optimiser,
        steps: int,
        coarse: float = 0.1,
    ) -> None:
        super().__init__()
        self.network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = copy.deepcopy(network).requires_grad_(False)
        self.objective, self.metrics, self.optimiser, self.steps = objective, dict(metrics), optimiser, steps
        self.coarse = coarse
        self.judged: list[Judged] = []

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """Loss of a batch of crops."""
        *coarser, enhanced = self.network.stages(batch.views)
        with torch.autocast(self.device.type, enabled=False):
            start = enlarged(batch.views.render, self.network.scale).clamp(0, 1)
            total, parts = self.objective(enhanced.float(), batch.photo, start)
            for image in coarser:
                photo, render = (
                    F.adaptive_avg_pool2d(full, (image.shape[-2], image.shape[-1])) for full in (batch.photo, start)
                )
                total = total + self.coarse * self.objective(image.float(), photo, render)[0]
        size = len(batch.names)
        self.log("train/total", total, prog_bar=True, batch_size=size, sync_dist=True)
        self.log_dict({f"train/{name}": value for name, value in parts.items()}, batch_size=size, sync_dist=True)
        return total

    def optimizer_step(self, *arguments: Any, **named: Any) -> None:
        """Step, and move the average towards the weights before a checkpoint can be written."""
        super().optimizer_step(*arguments, **named)
        follow(self.average, self.network, self.optimiser.average, self.global_step + 1)

    def on_validation_epoch_start(self) -> None:
        """Forget the last validation."""
        self.judged = []

    def validation_step(self, batch: Batch, index: int) -> dict[str, Any]:
        """Gain over the raw render on a whole image, both quantised to 8 bit; returns its place and image."""
        enhanced = quantised(self.average(batch.views).float())
        raw = quantised(enlarged(batch.views.render, self.network.scale))
        with torch.autocast(self.device.type, enabled=False):
            gains = {
                name: float(metric(enhanced, batch.photo) - metric(raw, batch.photo))
                for name, metric in self.metrics.items()
            }
        place = index * self.trainer.world_size + self.trainer.global_rank
        self.judged.append(Judged(place, batch.names[0], gains))
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
        adam = torch.optim.AdamW(groups, lr=self.optimiser.rate, betas=(0.9, 0.99))
        schedule = torch.optim.lr_scheduler.LambdaLR(adam, lambda step: self.optimiser.factor(step, self.steps))
        return {"optimizer": adam, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


def psnr(enhanced: Tensor, photo: Tensor) -> Tensor:
    """Peak signal-to-noise ratio in dB of images in [0, 1], 100 at most."""
    from torchmetrics.functional.image import peak_signal_noise_ratio

    return peak_signal_noise_ratio(enhanced, photo, data_range=1.0).clamp_max(100)


def ssim(enhanced: Tensor, photo: Tensor) -> Tensor:
    """Structural similarity as 3DGS measures it: 11x11 Gaussian window of 1.5 pixels, zero padding."""
    from gaussian_enhancer.objective.terms import dissimilarity

    return 1 - dissimilarity(enhanced, photo).mean()
