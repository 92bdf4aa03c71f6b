"""Density control as Markov chain Monte Carlo: dead Gaussians move to live ones, the number grows, centres explore.

Axes: n Gaussians, m Gaussians among them, s scale axes.
Source: Kheradmand et al., 3D Gaussian Splatting as Markov Chain Monte Carlo, NeurIPS 2024, equations 8 to 10 and
section 4.1. What differs: lengths in the noise are in camera extents, so that a scene's unit does not matter.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.fit.densify import due_between
from gaussian_enhancer.splat.fit.optimise import SplatOptimiser
from gaussian_enhancer.splat.fit.turned import rotate_vectors
from gaussian_enhancer.types import Gaussians

MOST_COPIES = 51
"""Largest number of copies that the formulas are asked for at once (theirs)."""
SHARPNESS = 100.0
"""Slope of the sigmoid that ends exploration above the dead opacity (theirs)."""


@dataclass(frozen=True)
class Relocation:
    """When and how Gaussians move, join and explore.

    Args:
        every: steps between relocations; 0 never relocates.
        start: share of the fit after which they begin.
        stop: share of the fit after which they end.
        opacity: Gaussians at or below this opacity are dead.
        growth: share by which one relocation increases the number, up to ``max_gaussians``.
        noise: strength of the exploration in units of the centres' learning rate; 0 explores nothing.
    """

    every: int = 100
    start: float = 0.016
    stop: float = 0.83
    opacity: float = 0.005
    growth: float = 0.05
    noise: float = 5e5

    def __post_init__(self) -> None:
        if self.every < 0:
            raise InputError("densification.every", f"is {self.every}", "give 0 or a number of steps")
        if not 0 <= self.start <= self.stop <= 1:
            raise InputError("densification.start, stop", f"are {self.start}, {self.stop}", "order them within 0 and 1")
        if not 0 < self.opacity < 1:
            raise InputError("densification.opacity", f"is {self.opacity}", "give an opacity between 0 and 1")
        if not (self.growth >= 0 and self.noise >= 0):
            raise InputError("densification.growth, noise", f"are {self.growth}, {self.noise}", "give none below 0")

    def due(self, step: int, steps: int) -> bool:
        """Whether Gaussians move after this step (counted from 1)."""
        return due_between(self.every, self.start, self.stop, step, steps)


def split_between_copies(
    opacities: Float[Tensor, " m"], copies: Int64[Tensor, " m"]
) -> tuple[Float[Tensor, " m"], Float[Tensor, " m"]]:
    """Opacity of each of N copies on one place that together equal one Gaussian, and the factor on their scales.

    o' = 1 - (1 - o)^(1/N),   s'/s = o / sum_{i=1..N} sum_{k=0..i-1} (i-1 over k) (-1)^k o'^(k+1) / sqrt(k+1)

    (equation 9). The factor keeps the integral of what the copies hide along a line through the centre.

    Args:
        opacities: in (0, 1).
        copies: N, at least 1.
    """
    old, count = opacities.double(), copies.clamp(1, MOST_COPIES)
    new = 1 - (1 - old) ** (1 / count.double())
    total = torch.zeros_like(old)
    for i in range(1, int(count.max()) + 1 if len(count) else 1):
        part = torch.zeros_like(old)
        for k in range(i):
            part += math.comb(i - 1, k) * (-1) ** k * new ** (k + 1) / math.sqrt(k + 1)
        total += torch.where(count >= i, part, 0)
    return new.to(opacities), (old / total).to(opacities)


@torch.no_grad()
def relocate(optimiser: SplatOptimiser, settings: Relocation, limit: int, generator: torch.Generator) -> None:
    """Move dead Gaussians to live ones drawn by opacity, then add some in the same way.

    Args:
        optimiser: the Gaussians and their moments; changed in place.
        settings: thresholds.
        limit: largest number of Gaussians.
        generator: source of randomness.
    """
    opacities = optimiser.gaussians(0).opacity_logits.sigmoid()
    dead = (opacities <= settings.opacity).nonzero()[:, 0]
    live = (opacities > settings.opacity).nonzero()[:, 0]
    if len(live) == 0:
        return
    if len(dead):
        chosen = live[_draw_indices(opacities[live], len(dead), generator)]
        optimiser.overwrite(dead, _split_opacity(optimiser, chosen, settings)[chosen])
    joining = min(limit, int((1 + settings.growth) * len(optimiser))) - len(optimiser)
    if joining > 0:
        chosen = _draw_indices(optimiser.gaussians(0).opacity_logits.sigmoid(), joining, generator)
        optimiser.append(_split_opacity(optimiser, chosen, settings)[chosen])


@torch.no_grad()
def explore(
    optimiser: SplatOptimiser, settings: Relocation, extent: float, number: int, generator: torch.Generator
) -> None:
    """Shift the centres of nearly transparent Gaussians at random, along their own shape (equation 8).

    With extents as the unit of length, dx = noise lr sigmoid(100 (0.005 - o)) Sigma eta with eta ~ N(0, I).

    Args:
        optimiser: whose Gaussians are shifted.
        settings: strength of the noise.
        extent: scene units of one camera extent.
        number: the step's number, from 0; the centres' learning rate fades over the fit.
        generator: source of randomness.
    """
    gaussians = optimiser.gaussians(0)
    gate = torch.sigmoid(SHARPNESS * (settings.opacity - gaussians.opacity_logits.sigmoid()))
    noise = torch.randn(len(gaussians), 3, generator=generator).to(gaussians.means)
    free = (gate > 1e-6).nonzero()[:, 0]
    scales = gaussians.log_scales[free].exp()
    quaternions = gaussians.quaternions[free]
    displacement = rotate_vectors(quaternions, noise[free], back=True)[:, : scales.shape[1]] * scales.square()
    strength = settings.noise * optimiser.means_rate(number) / extent**2 * gate[free]
    optimiser.shift(free, strength[:, None] * rotate_vectors(quaternions, displacement))


def _draw_indices(weights: Float[Tensor, " m"], count: int, generator: torch.Generator) -> Int64[Tensor, " d"]:
    """Indices drawn in proportion to the weights, with replacement."""
    # torch.multinomial refuses more than 2^24 weights
    edges = weights.double().cpu().cumsum(0)
    places = torch.rand(count, generator=generator, dtype=torch.float64) * edges[-1]
    return torch.searchsorted(edges, places, right=True).clamp(max=len(weights) - 1).to(weights.device)


def _split_opacity(optimiser: SplatOptimiser, drawn: Int64[Tensor, " d"], settings: Relocation) -> Gaussians:
    """Make each drawn Gaussian one of as many as it will be; all Gaussians afterwards."""
    now = optimiser.gaussians()
    parents, times = drawn.unique(return_counts=True)
    opacity, factor = split_between_copies(now.opacity_logits[parents].sigmoid(), times + 1)
    changed = now[parents]
    optimiser.overwrite(
        parents,
        Gaussians(
            changed.means,
            changed.log_scales + factor.log()[:, None],
            changed.quaternions,
            opacity.clamp(settings.opacity, 1 - 1e-6).logit(),
            changed.sh,
        ),
    )
    return optimiser.gaussians()
