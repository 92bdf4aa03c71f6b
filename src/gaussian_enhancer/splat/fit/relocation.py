"""Density control of 3DGS-MCMC: dead Gaussians move to live ones, Gaussians are added, and centres get noise.

Axes: n Gaussians, m Gaussians among them, s scale axes.
Source: Kheradmand et al., 3D Gaussian Splatting as Markov Chain Monte Carlo, NeurIPS 2024, equations 8 to 10 and
section 4.1. Difference: lengths in the noise are in camera extents, so that results do not depend on a scene's unit.
"""

import dataclasses
import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.fit.densify import Schedule
from gaussian_enhancer.splat.fit.optimise import SplatOptimiser
from gaussian_enhancer.splat.fit.rotation import rotate_vectors
from gaussian_enhancer.types import Gaussians

MOST_COPIES = 51
"""Largest number of copies that the formulas are evaluated for (the authors' value)."""
SHARPNESS = 100.0
"""Slope of the sigmoid that ends the noise above the opacity of dead Gaussians (the authors' value)."""


@dataclass(frozen=True)
class Relocation(Schedule):
    """When and how Gaussians are relocated, added and moved by noise.

    Args:
        every: steps between relocations; 0 turns them off.
        start: share of the fit after which relocations begin.
        stop: share of the fit after which relocations end.
        opacity: Gaussians at or below this opacity are dead.
        growth: share by which one relocation increases the number of Gaussians, up to ``max_gaussians``.
        noise: strength of the noise on the centres, in units of their learning rate; 0 turns it off.
    """

    start: float = 0.016
    stop: float = 0.83
    opacity: float = 0.005
    growth: float = 0.05
    noise: float = 5e5

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.opacity < 1:
            raise InputError("densification.opacity", f"is {self.opacity}", "give an opacity between 0 and 1")
        if not (self.growth >= 0 and self.noise >= 0):
            raise InputError("densification.growth, noise", f"are {self.growth}, {self.noise}", "give none below 0")


def split_between_copies(
    opacities: Float[Tensor, " m"], copies: Int64[Tensor, " m"]
) -> tuple[Float[Tensor, " m"], Float[Tensor, " m"]]:
    """Opacity of each of N copies at one place that together equal one Gaussian, and the factor on their scales.

    o' = 1 - (1 - o)^(1/N),   s'/s = o / sum_{i=1..N} sum_{k=0..i-1} (i-1 over k) (-1)^k o'^(k+1) / sqrt(k+1)

    (equation 9). The factor preserves the integral of the copies' joint opacity along a line through the centre.

    Args:
        opacities: in (0, 1).
        copies: N, at least 1.
    """
    opacity, count = opacities.double(), copies.clamp(1, MOST_COPIES)
    copy_opacity = 1 - (1 - opacity) ** (1 / count.double())
    total = torch.zeros_like(opacity)
    for i in range(1, int(count.max()) + 1 if len(count) else 1):
        term = torch.zeros_like(opacity)
        for k in range(i):
            term += math.comb(i - 1, k) * (-1) ** k * copy_opacity ** (k + 1) / math.sqrt(k + 1)
        total += torch.where(count >= i, term, 0)
    return copy_opacity.to(opacities), (opacity / total).to(opacities)


@torch.no_grad()
def relocate(optimiser: SplatOptimiser, settings: Relocation, limit: int, generator: torch.Generator) -> None:
    """Move dead Gaussians to live ones drawn in proportion to opacity, then add Gaussians in the same way.

    Args:
        optimiser: the Gaussians and their moments; changed in place.
        settings: thresholds.
        limit: largest number of Gaussians.
        generator: source of randomness.
    """
    opacities = optimiser.gaussians(0).opacity_logits.sigmoid()
    dead_indices = (opacities <= settings.opacity).nonzero()[:, 0]
    live_indices = (opacities > settings.opacity).nonzero()[:, 0]
    if len(live_indices) == 0:
        return
    if len(dead_indices):
        targets = live_indices[_draw_indices(opacities[live_indices], len(dead_indices), generator)]
        optimiser.overwrite(dead_indices, _split_opacity(optimiser, targets, settings)[targets])
    added_count = min(limit, int((1 + settings.growth) * len(optimiser))) - len(optimiser)
    if added_count > 0:
        targets = _draw_indices(optimiser.gaussians(0).opacity_logits.sigmoid(), added_count, generator)
        optimiser.append(_split_opacity(optimiser, targets, settings)[targets])


@torch.no_grad()
def explore(
    optimiser: SplatOptimiser, settings: Relocation, extent: float, number: int, generator: torch.Generator
) -> None:
    """Shift the centres of nearly transparent Gaussians by noise that is shaped by their covariance (equation 8).

    With the camera extent as the unit of length, dx = noise lr sigmoid(100 (0.005 - o)) Sigma eta with eta ~ N(0, I).

    Args:
        optimiser: the Gaussians, whose centres are shifted in place.
        settings: strength of the noise.
        extent: camera extent in scene units.
        number: the step's number, from 0; the centres' learning rate decays over the fit.
        generator: source of randomness.
    """
    gaussians = optimiser.gaussians(0)
    gate = torch.sigmoid(SHARPNESS * (settings.opacity - gaussians.opacity_logits.sigmoid()))
    noise = torch.randn(len(gaussians), 3, generator=generator).to(gaussians.means)
    movable = (gate > 1e-6).nonzero()[:, 0]
    scales = gaussians.log_scales[movable].exp()
    quaternions = gaussians.quaternions[movable]
    displacement = rotate_vectors(quaternions, noise[movable], back=True)[:, : scales.shape[1]] * scales.square()
    strength = settings.noise * optimiser.means_rate(number) / extent**2 * gate[movable]
    optimiser.shift(movable, strength[:, None] * rotate_vectors(quaternions, displacement))


def _draw_indices(weights: Float[Tensor, " m"], count: int, generator: torch.Generator) -> Int64[Tensor, " d"]:
    """Indices drawn in proportion to the weights, with replacement."""
    # torch.multinomial does not take more than 2^24 weights
    cumulative_weights = weights.double().cpu().cumsum(0)
    samples = torch.rand(count, generator=generator, dtype=torch.float64) * cumulative_weights[-1]
    return torch.searchsorted(cumulative_weights, samples, right=True).clamp(max=len(weights) - 1).to(weights.device)


def _split_opacity(optimiser: SplatOptimiser, drawn: Int64[Tensor, " d"], settings: Relocation) -> Gaussians:
    """Give each drawn Gaussian the opacity and scales of one of its copies, in place; return all Gaussians."""
    gaussians = optimiser.gaussians()
    parents, draw_counts = drawn.unique(return_counts=True)
    opacity, factor = split_between_copies(gaussians.opacity_logits[parents].sigmoid(), draw_counts + 1)
    originals = gaussians[parents]
    optimiser.overwrite(
        parents,
        dataclasses.replace(
            originals,
            log_scales=originals.log_scales + factor.log()[:, None],
            opacity_logits=opacity.clamp(settings.opacity, 1 - 1e-6).logit(),
        ),
    )
    return optimiser.gaussians()
