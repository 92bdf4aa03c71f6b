"""Latent diffusion of degradation factors, for photos that have no real render.

A code z and noise n give z_t = a z + s n with a^2 + s^2 = 1; time t runs from 0 (clean) to 1 (noise). The network
predicts the clean code, as DiffIR's does; it is trained at every time, so that any number of steps can be taken.
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

LONG = 64
"""Steps of the sampler beyond which half precision is not trusted with a walk."""


@runtime_checkable
class Schedule(Protocol):
    """How the signal falls from 1 at time 0, never rising."""

    def signal(self, time: Tensor) -> Tensor:
        """The signal a at times in [0, 1]."""
        ...


@dataclass(frozen=True)
class CosineSchedule:
    """a = cos(pi t / 2): noise rises evenly (Nichol and Dhariwal, ICML 2021).

    Args:
        end: last time, below 1, where a little of the signal is left.
    """

    end: float = 0.995

    def signal(self, time: Tensor) -> Tensor:
        """The signal a at times in [0, 1]."""
        return torch.cos(0.5 * math.pi * self.end * time)


@dataclass(frozen=True)
class LinearSchedule:
    """DiffIR's: a^2 = prod (1 - beta), square roots of beta evenly spaced, as a function of continuous time.

    The product over T steps is extended between them by linear interpolation of its logarithm.

    Args:
        first: beta of the first step.
        last: beta of the last step.
        steps: T.
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
        share = position - below
        return torch.exp(0.5 * (logs[below] + share * (logs[below + 1] - logs[below])))


@dataclass(frozen=True)
class Sampler:
    """How noise becomes a code.

    Args:
        steps: evaluations of the network.
        noise: share of the fresh noise of each step: 1 is ancestral sampling (Ho et al., NeurIPS 2020), 0 is DDIM
            (Song et al., ICLR 2021), which keeps more of the codes' spread in few steps.
        mean: take the posterior's mean and add no noise, as DiffIR does; ``noise`` is then of no effect.

    Raises:
        InputError: no step, or a share outside [0, 1].
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
        """Walk from noise to a code; the code is float32 where the noise is in half precision, whose roundings add up.

        Walks of more than `LONG` steps stay outside autocast, where a stiff schedule magnifies them beyond use.

        Args:
            predict: the clean code, given a noisy one and its time.
            start: standard normal factors.
            schedule: signal by time.
            generators: sources of the fresh noise, one for each sample.
        """
        times = torch.linspace(1, 0, self.steps + 1, dtype=torch.float64)
        signals = schedule.signal(times).tolist()
        z = Factors(single_precision(start.vector), single_precision(start.grid))
        for k in range(self.steps):
            if k > 0 and signals[k] == 1:
                return z  # no noise is left: z is the clean code, of which the network knows nothing more
            now = torch.full((start.vector.shape[0],), float(times[k])).to(z.vector)
            with torch.autocast(now.device.type, enabled=False) if self.steps > LONG else nullcontext():
                clean = predict(z.to(start.vector.dtype), now)
            clean = Factors(clean.vector.to(z.vector.dtype), clean.grid.to(z.grid.dtype))
            z = clean if k == self.steps - 1 else self._step(z, clean, signals[k], signals[k + 1], generators)
        return z

    def _step(
        self, z: Factors, clean: Factors, now: float, then: float, generators: Sequence[torch.Generator]
    ) -> Factors:
        """From signal ``now`` to the signal ``then``, which is no smaller.

        A stiff schedule holds still where no signal has come yet: there z stays.
        """
        if then == now:
            return z
        noise_now, noise_then = 1 - now**2, 1 - then**2
        ratio = (now / then) ** 2
        fresh = max(0.0, noise_then / noise_now * (1 - ratio))
        if self.mean:
            return z.linear_combination(clean, (now / then) * noise_then / noise_now, then * (1 - ratio) / noise_now)
        sigma2 = self.noise**2 * fresh
        along = math.sqrt(max(0.0, noise_then - sigma2) / noise_now)
        z = z.linear_combination(clean, along, then - along * now)
        return z.linear_combination(white_noise(z, generators), 1.0, math.sqrt(sigma2)) if sigma2 > 0 else z


class Denoiser(nn.Module):
    """The clean code of a noisy one, given M: a small convolutional network on the grid, with the vector beside it.

    Args:
        vector: entries of z's vector.
        grid: channels of z's grid.
        width: channels of the features.
        blocks: refinements of M's features at each resolution, and of the joined features.
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
        """Features of M, the same for all steps."""
        return self.condition(manual)

    def forward(self, noisy: Factors, time: Float[Tensor, " b"], features: Float[Tensor, "b k i j"]) -> Factors:
        """Predict the clean code.

        Args:
            noisy: z_t.
            time: t of each sample, in [0, 1]; in single precision at least, as its waves are short.
            features: what `features` said of M.
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
