"""Training the simulator's second stage, in two steps, on real pairs of photo and render.

Axes: b batch, h height, w width.
"""

import copy
from dataclasses import dataclass
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from lightning import LightningModule
from torch import Tensor

from gaussian_enhancer.degrade.diffuse import Sampler
from gaussian_enhancer.degrade.draws import spawn
from gaussian_enhancer.degrade.factors import Factors
from gaussian_enhancer.degrade.generative import SCHEDULES, FactorModel
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.train.average import follow
from gaussian_enhancer.train.discriminator import Discriminator, critic_loss, feature_distance
from gaussian_enhancer.train.module import Optimiser
from gaussian_enhancer.types import Batch


@dataclass(frozen=True)
class GeneratorLoss:
    """Weights of what the second stage is trained for.

    Args:
        pixels: of the mean absolute difference between L and R.
        adversarial: of the discriminator's verdict on L.
        features: of the distance between the discriminator's features of L and of R (first step alone).
        size: of z's mean square, which keeps codes where noise can reach them.
        noise: standard deviation of the noise on z in the first step: what z says must survive it.
        sampled_pixels: as ``pixels``, for sampled z (second step), where L need not equal R.
    """

    pixels: float = 10.0
    adversarial: float = 0.1
    features: float = 1.0
    size: float = 1e-3
    noise: float = 0.3
    sampled_pixels: float = 1.0


class _GeneratorModule(LightningModule):
    """What both steps share: one optimiser for simulator and discriminator, a running mean."""

    def __init__(self, model: FactorModel, loss: GeneratorLoss, optimiser: Optimiser, steps: int, seed: int) -> None:
        super().__init__()
        self.model = model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = copy.deepcopy(model).requires_grad_(False)
        self.discriminator = Discriminator().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.loss, self.optimiser, self.steps, self.seed = loss, optimiser, steps, seed

    def prepared(self, batch: Batch, index: int) -> tuple[Tensor, Tensor, tuple[torch.Generator, ...]]:
        """Stage 1's output M, the real renders R, and generators that follow from the index and the seed."""
        if batch.real is None:
            raise InputError("data", "simulates nothing", "train the generator with data.simulated=1")
        generator = torch.Generator().manual_seed(1_000_003 * self.seed + index)
        return batch.views.render, batch.real, spawn(len(batch.names), generator)

    def judged(
        self, photo: Float[Tensor, "b 3 h w"], real: Float[Tensor, "b 3 h w"], made: Float[Tensor, "b 3 h w"]
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Adversarial loss and feature distance of the simulator, and the discriminator's own loss.

        Each loss reaches its own network's weights alone, so that one optimiser serves both.
        """
        self.discriminator.requires_grad_(False)
        verdict, features = self.discriminator(photo, made)
        with torch.no_grad():
            _, wanted = self.discriminator(photo, real)
        fooling, distance = -verdict.float().mean(), feature_distance(wanted, features)
        self.discriminator.requires_grad_(True)
        critic = critic_loss(self.discriminator(photo, real)[0], self.discriminator(photo, made.detach())[0])
        return fooling, distance, critic

    def on_train_batch_end(self, outputs: Any, batch: Batch, index: int) -> None:
        """Move the running mean."""
        follow(self.average, self.model, self.optimiser.average, self.global_step)

    def configure_optimizers(self) -> Any:
        """Adam on simulator and discriminator; momentum as usual in adversarial training."""
        parameters = [p for p in self.parameters() if p.requires_grad]
        adam = torch.optim.Adam(parameters, lr=self.optimiser.rate, betas=(0.5, 0.99))
        schedule = torch.optim.lr_scheduler.LambdaLR(adam, lambda step: self.optimiser.factor(step, self.steps))
        return {"optimizer": adam, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def _logged(self, values: dict[str, Tensor], batch: Batch) -> None:
        self.log_dict({f"train/{name}": value.detach() for name, value in values.items()}, batch_size=len(batch.names))


class PairedModule(_GeneratorModule):
    """First step: extractor and combiner on real pairs, z = DE(M, R) + noise, L = DC(M, z) near R.

    Args:
        model: stage 2's networks; the denoiser is left alone.
        loss: weights of the terms.
        optimiser: how.
        steps: length of the training, for the schedule.
        seed: of all noise.
    """

    def __init__(
        self,
        model: FactorModel,
        loss: GeneratorLoss,
        optimiser: Optimiser,
        steps: int,
        seed: int = 0,
    ) -> None:
        super().__init__(model, loss, optimiser, steps, seed)
        model.denoiser.requires_grad_(False)

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """Loss of a batch of crops."""
        manual, real, generators = self.prepared(batch, self.global_step)
        factors = self.model.extractor(manual, real)
        noisy = factors.combined(_white(factors), 1.0, self.loss.noise)
        made = self.model.combine(manual, noisy, generators)
        self._scale(factors)
        fooling, distance, critic = self.judged(batch.photo, real, made)
        size = _size(factors)
        pixels = (made.float() - real).abs().mean()
        loss = self.loss
        total = loss.pixels * pixels + loss.adversarial * fooling + loss.features * distance + loss.size * size
        parts = {"pixels": pixels, "fooling": fooling, "features": distance, "critic": critic, "size": size}
        self._logged(parts, batch)
        return total + critic

    def validation_step(self, batch: Batch, index: int) -> None:
        """How much of the difference between M and R is left in L, in dB of PSNR against R."""
        manual, real, generators = self.prepared(batch, index)
        made = self.average.combine(manual, self.average.extractor(manual, real), generators)
        left, before = F.mse_loss(made.float().clamp(0, 1), real), F.mse_loss(manual, real)
        self.log("gain/paired", 10 * torch.log10((before + 1e-8) / (left + 1e-8)), prog_bar=True, batch_size=1)

    @torch.no_grad()
    def _scale(self, factors: Factors) -> None:
        """Keep track of the size of codes, with their noise: the denoiser's unit."""
        for buffer, part, dims in (
            (self.model.vector_scale, factors.vector, (0,)),
            (self.model.grid_scale, factors.grid, (0, 2, 3)),
        ):
            spread = (part.float().square().mean(dims) + self.loss.noise**2).sqrt().view_as(buffer)
            buffer.lerp_(spread, 0.01)


class DiffusedModule(_GeneratorModule):
    """Second step: the denoiser learns the codes of the first step's extractor, the combiner to use sampled ones.

    DiffIR unrolls its four steps and asks for the extractor's very code (L1), which makes samples of a code that M
    does not determine collapse to one. Here the denoiser is trained at a random time to predict the code (L2), which is
    what sampling needs, and the combiner sees sampled codes, judged by the discriminator.

    Args:
        model: stage 2's networks after the first step; the extractor is left alone.
        loss: weights of the terms.
        optimiser: how.
        steps: length of the training, for the schedule.
        sampler: how codes are sampled in training.
        seed: of all noise.
    """

    def __init__(
        self,
        model: FactorModel,
        loss: GeneratorLoss,
        optimiser: Optimiser,
        steps: int,
        sampler: Sampler,
        seed: int = 0,
    ) -> None:
        super().__init__(model, loss, optimiser, steps, seed)
        model.extractor.requires_grad_(False)
        self.sampler = sampler

    def training_step(self, batch: Batch, index: int) -> Tensor:
        """Loss of a batch of crops."""
        manual, real, generators = self.prepared(batch, self.global_step)
        denoising = self._denoising(manual, real)
        with torch.no_grad():
            sampled = self.model.sample(manual, self.sampler, generators)
        made = self.model.combine(manual, sampled, generators)
        fooling, distance, critic = self.judged(batch.photo, real, made)
        pixels = (made.float() - real).abs().mean()
        loss = self.loss
        total = denoising + loss.sampled_pixels * pixels + loss.adversarial * fooling
        parts = {"denoising": denoising, "pixels": pixels, "fooling": fooling, "features": distance, "critic": critic}
        self._logged(parts, batch)
        return total + critic

    def validation_step(self, batch: Batch, index: int) -> None:
        """Share of the code's variance that the denoiser cannot tell; PSNR of sampled views against R, in dB."""
        manual, real, generators = self.prepared(batch, index)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(index)
            self.log("left/denoising", self._denoising(manual, real, self.average), batch_size=1)
        sampled = self.average.sample(manual, self.sampler, generators)
        made = self.average.combine(manual, sampled, generators).float().clamp(0, 1)
        difference = 10 * torch.log10(F.mse_loss(manual, real) / F.mse_loss(made, real))
        self.log("gain/diffused", difference, prog_bar=True, batch_size=1)

    def _denoising(self, manual: Tensor, real: Tensor, model: FactorModel | None = None) -> Tensor:
        """Mean squared error of the clean code at a random time, in units of the code's own size."""
        model = self.model if model is None else model
        with torch.no_grad():
            factors = model.extractor(manual, real)
            factors = Factors(factors.vector.float(), factors.grid.float())
            clean = model.standardised(factors.combined(_white(factors), 1.0, self.loss.noise))
        time = torch.rand(len(manual), device=manual.device)
        signal = SCHEDULES[model.design.schedule].signal(time)
        noisy = clean.combined(_white(clean), signal, (1 - signal.square()).clamp_min(0).sqrt())
        found = model.denoiser(noisy, time, model.denoiser.features(manual))
        parts = [
            F.mse_loss(a.float(), b)
            for a, b in ((found.vector, clean.vector), (found.grid, clean.grid))
            if b.numel() > 0
        ]
        return torch.stack(parts).mean()


def _white(like: Factors) -> Factors:
    return Factors(torch.randn_like(like.vector), torch.randn_like(like.grid))


def _size(factors: Factors) -> Tensor:
    parts = [part.float().square().mean() for part in (factors.vector, factors.grid) if part.numel() > 0]
    return torch.stack(parts).mean()
