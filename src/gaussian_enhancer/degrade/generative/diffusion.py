"""Latent diffusion of degradation factors, for photos without a real render.

With a code z and noise n, z_t = a z + s n with a^2 + s^2 = 1, where time t runs from 0 (clean) to 1 (noise). The
network predicts the clean code, as in DiffIR. It is trained at all times, so that samplers may use any number of steps.
Axes: b batch, k channels of features, h height, w width, i = ceil(h / 8), j = ceil(w / 8).
"""

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.degrade.generative.extractor import Refine, Trunk
from gaussian_enhancer.degrade.generative.factors import Factors, convolution, linear, white_noise
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import single_precision

MAX_AUTOCAST_STEPS = 64
"""Largest number of sampling steps for which half precision is accurate enough."""


@runtime_checkable
class Schedule(Protocol):
    """Noise schedule: the signal a as a function of time, 1 at time 0 and never increasing."""

    def signal(self, time: Tensor) -> Tensor:
        """The signal a at times in [0, 1]."""
        ...


@dataclass(frozen=True)
class CosineSchedule:
    """a = cos(pi t end / 2), after Nichol and Dhariwal (ICML 2021).

    Args:
        end: factor of time, below 1, so that a little of the signal remains at time 1.
    """

    end: float = 0.995

    def signal(self, time: Tensor) -> Tensor:
        """The signal a at times in [0, 1]."""
        return torch.cos(0.5 * math.pi * self.end * time)


@dataclass(frozen=True)
class LinearSchedule:
    """DiffIR's schedule a^2 = prod (1 - beta), with evenly spaced square roots of beta, for continuous time.

    Between its T steps, the logarithm of the product is interpolated linearly.

    Args:
        first: beta of the first step.
        last: beta of the last step.
        steps: number of steps T.
    """

    first: float = 0.1
    last: float = 0.99
    steps: int = 4

    def signal(self, time: Tensor) -> Tensor:
        """The signal a at times in [0, 1]."""
        roots = torch.linspace(self.first**0.5, self.last**0.5, self.steps, device=time.device, dtype=time.dtype)
        logs = torch.cat([roots.new_zeros(1), torch.log1p(-roots.square()).cumsum(0)])
        position = (time * self.steps).clamp(0, self.steps)
        below = position.floor().long().clamp(max=self.steps - 1)
        fraction = position - below
        return torch.exp(0.5 * (logs[below] + fraction * (logs[below + 1] - logs[below])))


@dataclass(frozen=True)
class Sampler:
    """Sampler of codes from noise.

    Args:
        steps: number of sampling steps, each an evaluation of the network.
        noise: standard deviation of the noise added at each step, relative to ancestral sampling: 1 is ancestral
            sampling (Ho et al., NeurIPS 2020), 0 is DDIM (Song et al., ICLR 2021), which preserves more of the codes'
            variance with few steps.
        mean: take the posterior's mean and add no noise, as DiffIR does; ``noise`` then has no effect.

    Raises:
        InputError: ``steps`` is below 1, or ``noise`` is outside [0, 1].
    """

    steps: int = 8
    noise: float = 0.0
    mean: bool = False

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise InputError("sampler.steps", f"is {self.steps}", "take at least one step")
        if not 0 <= self.noise <= 1:
            raise InputError("sampler.noise", f"is {self.noise}", "give a share from 0 to 1")

    def __call__(
        self,
        predict: Callable[[Factors, Float[Tensor, " b"]], Factors],
        start: Factors,
        schedule: Schedule,
        generators: Sequence[torch.Generator],
    ) -> Factors:
        """Sample a code from noise. From noise in half precision the code is float32, because rounding errors add up.

        With more than `MAX_AUTOCAST_STEPS` steps autocast is disabled, because a stiff schedule amplifies rounding
        errors too much.

        Args:
            predict: predicts the clean code from a noisy one and its time.
            start: standard normal factors.
            schedule: noise schedule.
            generators: sources of the added noise, one for each sample.
        """
        times = torch.linspace(1, 0, self.steps + 1, dtype=torch.float64)
        signals = schedule.signal(times).tolist()
        z = Factors(single_precision(start.vector), single_precision(start.grid))
        for k in range(self.steps):
            if k > 0 and signals[k] == 1:
                return z  # no noise is left: z is already the clean code
            time = torch.full((start.vector.shape[0],), float(times[k])).to(z.vector)
            with torch.autocast(time.device.type, enabled=False) if self.steps > MAX_AUTOCAST_STEPS else nullcontext():
                clean = predict(z.to(start.vector.dtype), time)
            clean = Factors(clean.vector.to(z.vector.dtype), clean.grid.to(z.grid.dtype))
            z = clean if k == self.steps - 1 else self._step(z, clean, signals[k], signals[k + 1], generators)
        return z

    def _step(
        self,
        z: Factors,
        clean: Factors,
        current_signal: float,
        next_signal: float,
        generators: Sequence[torch.Generator],
    ) -> Factors:
        """Step from signal ``current_signal`` to the signal ``next_signal``, which is no smaller.

        If both are equal, as where a stiff schedule still has no signal, z stays unchanged.
        """
        if next_signal == current_signal:
            return z
        current_variance, next_variance = 1 - current_signal**2, 1 - next_signal**2
        ratio = current_signal / next_signal
        if self.mean:
            z_weight = ratio * next_variance / current_variance
            return z.linear_combination(clean, z_weight, next_signal * (1 - ratio**2) / current_variance)
        posterior_variance = max(0.0, next_variance / current_variance * (1 - ratio**2))
        added_variance = self.noise**2 * posterior_variance
        z_weight = math.sqrt(max(0.0, next_variance - added_variance) / current_variance)
        z = z.linear_combination(clean, z_weight, next_signal - z_weight * current_signal)
        if added_variance == 0:
            return z
        return z.linear_combination(white_noise(z, generators), 1.0, math.sqrt(added_variance))


class Denoiser(nn.Module):
    """Predicts the clean code from a noisy one and M, by a small convolutional network on the grid and the vector.

    Args:
        vector: entries of z's vector.
        grid: channels of z's grid.
        width: channels of the features.
        blocks: residual blocks for M's features at each resolution; the joined features have twice as many.
    """

    def __init__(self, vector: int = 32, grid: int = 8, width: int = 64, blocks: int = 2) -> None:
        super().__init__()
        self.condition = Trunk(3, width, blocks)
        self.time = nn.Sequential(nn.Linear(16, width), nn.ReLU(), nn.Linear(width, width))
        self.vector_in = linear(vector, width)
        self.grid_in = convolution(grid, width, 3)
        self.joined = nn.ModuleList([Refine(width) for _ in range(2 * blocks)])
        self.grid_out = convolution(width, grid, 3)
        self.vector_out = nn.Sequential(nn.Linear(2 * width, 2 * width), nn.ReLU(), linear(2 * width, vector))

    def features(self, manual: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b k i j"]:
        """Features of M, which are the same for all sampling steps."""
        return self.condition(manual)

    def forward(self, noisy: Factors, time: Float[Tensor, " b"], features: Float[Tensor, "b k i j"]) -> Factors:
        """Predict the clean code.

        Args:
            noisy: z_t.
            time: t of each sample, in [0, 1]; at least in single precision, because its embedding has high frequencies.
            features: M's features, from the method `features`.
        """
        frequencies = math.pi * 2.0 ** torch.arange(8, device=time.device, dtype=time.dtype)
        waves = time[:, None] * frequencies
        waves = torch.cat([waves.sin(), waves.cos()], dim=1).to(noisy.vector.dtype)
        embedded = self.time(waves) + self.vector_in(noisy.vector)
        x = self.grid_in(noisy.grid) + features + embedded[:, :, None, None]
        for block in self.joined:
            x = block(x)
        pooled = torch.cat([x.mean(dim=(2, 3)), embedded], dim=1)
        return Factors(self.vector_out(pooled), self.grid_out(x))
