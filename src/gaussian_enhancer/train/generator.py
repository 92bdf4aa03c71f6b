"""Training of the simulator's second stage, in two steps, on real pairs of photo and render.

Axes: b batch, h height, w width.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
import torch.nn.functional as F
from lightning import LightningModule
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import spawn, uniform
from gaussian_enhancer.degrade.generative.diffusion import Sampler
from gaussian_enhancer.degrade.generative.factors import Factors, white_noise
from gaussian_enhancer.degrade.generative.second_stage import SCHEDULES, FactorModel
from gaussian_enhancer.degrade.generative.texture import texture_difference
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.train.optimizers import MakeOptimizer, MakeScheduler, optimizer_configuration
from gaussian_enhancer.types import Batch


@dataclass(frozen=True)
class GeneratorLoss:
    """Weights of the second stage's losses.

    Args:
        pixels: weight of the mean absolute difference between the output L and the real render R.
        texture: weight of the difference between the local strengths of their detail.
        size: weight of the mean square of the code z, which keeps z small compared with the noise.
        noise: standard deviation of the noise added to z in the first step. The information in z must survive it.
    """

    pixels: float = 3.0
    texture: float = 30.0
    size: float = 1e-3
    noise: float = 0.3


class _GeneratorModule(LightningModule):
    """Base of both steps: reads a batch and configures the optimizer."""

    monitor: str
    """Name of the logged value that schedulers of the learning rate watch."""

    def __init__(
        self,
        model: FactorModel,
        loss: GeneratorLoss,
        optimizer: MakeOptimizer,
        lr_scheduler: MakeScheduler | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.model = model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.loss, self.optimizer, self.lr_scheduler, self.seed = loss, optimizer, lr_scheduler, seed

    def prepare_batch(self, batch: Batch, index: int) -> tuple[Tensor, Tensor, tuple[torch.Generator, ...]]:
        """Stage 1's output M, the real renders R, and generators seeded by the index and the seed.

        Raises:
            InputError: the batch has no real renders, because nothing was simulated.
        """
        if batch.real is None:
            raise InputError("data", "simulates nothing", "train the generator with data.simulation.share=1")
        generator = torch.Generator().manual_seed(1_000_003 * self.seed + index)
        return batch.views.render, batch.real, spawn(len(batch.names), generator)

    def configure_optimizers(self) -> Any:
        """Optimizer of the parameters that this step trains."""
        groups = [{"params": [p for p in self.parameters() if p.requires_grad]}]
        return optimizer_configuration(groups, self.optimizer, self.lr_scheduler, monitor=self.monitor)

    def _log_values(self, values: dict[str, Tensor], batch: Batch) -> None:
        self.log_dict({f"train/{name}": value.detach() for name, value in values.items()}, batch_size=len(batch.names))


class PairedModule(_GeneratorModule):
    """First step: trains extractor DE and combiner DC on real pairs: z = DE(M, R) + noise, L = DC(M, z) close to R.

    Args:
        model: stage 2's networks; the denoiser is not trained.
        loss: weights of the terms.
        optimizer: makes the optimizer from parameter groups.
        lr_scheduler: makes the learning-rate scheduler from the optimizer; None keeps the learning rate.
        seed: seed of all noise.
    """

    monitor = "gain/paired"

    def __init__(
        self,
        model: FactorModel,
        loss: GeneratorLoss,
        optimizer: MakeOptimizer,
        lr_scheduler: MakeScheduler | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(model, loss, optimizer, lr_scheduler, seed)
        model.denoiser.requires_grad_(False)

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """Loss of a batch of crops."""
        manual, real, generators = self.prepare_batch(batch, self.global_step)
        factors = self.model.extractor(manual, real)
        noisy_factors = factors.linear_combination(white_noise(factors, generators), 1.0, self.loss.noise)
        output = self.model.combine(manual, noisy_factors, generators).float()
        self._update_scale(factors)
        with torch.autocast(self.device.type, enabled=False):
            terms = {
                "pixels": (output - real).abs().mean(),
                "texture": texture_difference(output, real),
                "size": _mean_square(factors),
            }
        self._log_values(terms, batch)
        weights = self.loss
        return weights.pixels * terms["pixels"] + weights.texture * terms["texture"] + weights.size * terms["size"]

    def validation_step(self, batch: Batch, index: int) -> None:
        """Log how much closer L is to R than M is: gain in PSNR, and remaining share of the texture difference."""
        manual, real, generators = self.prepare_batch(batch, index)
        output = self.model.combine(manual, self.model.extractor(manual, real), generators).float().clamp(0, 1)
        self.log("gain/paired", _psnr_gain(manual, output, real), prog_bar=True, batch_size=1)
        self.log("texture/paired", _texture_ratio(manual, output, real), prog_bar=True, batch_size=1)

    @torch.no_grad()
    def _update_scale(self, factors: Factors) -> None:
        """Update the running root mean square of codes with noise, by which the denoiser's codes are scaled."""
        for buffer, code, dims in (
            (self.model.vector_scale, factors.vector, (0,)),
            (self.model.grid_scale, factors.grid, (0, 2, 3)),
        ):
            rms = (code.float().square().mean(dims) + self.loss.noise**2).sqrt().view_as(buffer)
            buffer.lerp_(rms, 0.01)


class DiffusedModule(_GeneratorModule):
    """Second step: trains the denoiser on the codes of the first step's extractor; all other weights are frozen.

    DiffIR unrolls its four steps and compares the result with the extractor's code (L1). Where M does not determine
    the code, all samples then collapse to one. Here the denoiser is trained at a random time to predict the code (L2),
    as sampling requires. The combiner was trained on codes with noise, and takes sampled codes unchanged.

    Args:
        model: stage 2's networks after the first step.
        loss: only ``noise`` is used, with the value of the first step.
        optimizer: makes the optimizer from parameter groups.
        sampler: how codes are sampled in validation.
        lr_scheduler: makes the learning-rate scheduler from the optimizer; None keeps the learning rate.
        seed: seed of all noise.
    """

    monitor = "gain/diffused"

    def __init__(
        self,
        model: FactorModel,
        loss: GeneratorLoss,
        optimizer: MakeOptimizer,
        sampler: Sampler,
        lr_scheduler: MakeScheduler | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(model, loss, optimizer, lr_scheduler, seed)
        model.requires_grad_(False)
        model.denoiser.requires_grad_(True)
        self.sampler = sampler

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """Loss of a batch of crops."""
        denoising = self._denoising_loss(*self.prepare_batch(batch, self.global_step))
        self._log_values({"denoising": denoising}, batch)
        return denoising

    def validation_step(self, batch: Batch, index: int) -> None:
        """Log the denoising error, and how much closer sampled views are to R than M is."""
        manual, real, generators = self.prepare_batch(batch, index)
        self.log("left/denoising", self._denoising_loss(manual, real, generators), batch_size=1)
        sampled = self.model.sample(manual, self.sampler, generators)
        output = self.model.combine(manual, sampled, generators).float().clamp(0, 1)
        self.log("gain/diffused", _psnr_gain(manual, output, real), prog_bar=True, batch_size=1)
        self.log("texture/diffused", _texture_ratio(manual, output, real), prog_bar=True, batch_size=1)

    def _denoising_loss(self, manual: Tensor, real: Tensor, generators: Sequence[torch.Generator]) -> Tensor:
        """Mean squared error of the predicted clean code at a random time, on standardised codes."""
        model = self.model
        with torch.no_grad():
            factors = model.extractor(manual, real)
            factors = Factors(factors.vector.float(), factors.grid.float())
            clean = model.standardise(
                factors.linear_combination(white_noise(factors, generators), 1.0, self.loss.noise)
            )
        time = uniform(0.0, 1.0, (), generators, manual)
        signal = SCHEDULES[model.design.schedule].signal(time)
        noisy = clean.linear_combination(
            white_noise(clean, generators), signal, (1 - signal.square()).clamp_min(0).sqrt()
        )
        predicted = model.denoiser(noisy, time, model.denoiser.features(manual))
        pairs = ((predicted.vector, clean.vector), (predicted.grid, clean.grid))
        return torch.stack([F.mse_loss(a.float(), b) for a, b in pairs if b.numel() > 0]).mean()


def _mean_square(factors: Factors) -> Tensor:
    means = [code.float().square().mean() for code in (factors.vector, factors.grid) if code.numel() > 0]
    return torch.stack(means).mean()


def _psnr_gain(manual: Tensor, output: Tensor, real: Tensor) -> Tensor:
    """How much higher the output's PSNR to R is than that of M, in dB."""
    return 10 * torch.log10((F.mse_loss(manual, real) + 1e-8) / (F.mse_loss(output, real) + 1e-8))


def _texture_ratio(manual: Tensor, output: Tensor, real: Tensor) -> Tensor:
    """Texture difference of the output to R as a share of that of M."""
    return texture_difference(output, real) / texture_difference(manual, real).clamp_min(1e-6)
