"""Adaptive density control: Gaussians are added where gradients are large, and invisible ones are removed.

Axes: n Gaussians, s scale axes.
Source: Kerbl et al., 3D Gaussian Splatting, SIGGRAPH 2023, section 5.2.
Differences: the number of Gaussians is bounded, those with the largest screen gradients are densified first, and
opacities are never reset. Two Gaussians that replace one of opacity o get the opacity 1 - sqrt(1 - o) each (Rota Bulo
et al., Revising Densification, ECCV 2024, equation 9), so that the render does not change abruptly.
"""

import dataclasses
from dataclasses import dataclass
from typing import Annotated

import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.fit.optimise import SplatOptimiser
from gaussian_enhancer.splat.fit.rotation import rotate_vectors
from gaussian_enhancer.splat.screen import ScreenStatistics
from gaussian_enhancer.typed import check_fields
from gaussian_enhancer.types import Gaussians

SPLIT_SHRINK = 1.6
"""The two halves of a split Gaussian have its scales divided by 1.6 (3DGS)."""


@dataclass(frozen=True)
class Schedule:
    """When the number of Gaussians changes.

    Args:
        every: steps between changes; 0 turns changes off.
        start: share of the fit after which changes begin.
        stop: share of the fit after which changes end.
    """

    every: int = 100
    start: float = 0.0
    stop: float = 1.0

    def __post_init__(self) -> None:
        check_fields(self, "densification.")
        if self.every < 0:
            raise InputError("densification.every", f"is {self.every}", "give 0 or a number of steps")
        if not 0 <= self.start <= self.stop <= 1:
            raise InputError("densification.start, stop", f"are {self.start}, {self.stop}", "order them within 0 and 1")

    def is_due(self, step: int, steps: int) -> bool:
        """Whether a change follows this step (counted from 1)."""
        return self.every > 0 and self.start * steps <= step <= self.stop * steps and step % self.every == 0


@dataclass(frozen=True)
class Densification(Schedule):
    """When and how the number of Gaussians changes.

    Args:
        every: steps between changes; 0 turns changes off.
        start: share of the fit after which changes begin.
        stop: share of the fit after which changes end.
        pull: mean screen gradient above which a Gaussian is cloned or split, in units of half the image's longer side.
        small: largest scale of a Gaussian that is cloned rather than split, in camera extents.
        opacity: Gaussians below this opacity are removed.
        world_size: Gaussians with a larger scale are removed, in camera extents.
        growth: largest share by which one change may increase the number of Gaussians.

    Raises:
        InputError: a number is out of range.
    """

    start: float = 0.05
    stop: float = 0.6
    pull: Annotated[float, Field(ge=0)] = 4e-4
    small: Annotated[float, Field(ge=0)] = 0.01
    opacity: Annotated[float, Field(ge=0, lt=1)] = 0.01
    world_size: Annotated[float, Field(gt=0)] = 1.0
    growth: Annotated[float, Field(ge=0)] = 0.2


class ScreenGradientMean:
    """Running mean of the screen gradient of each Gaussian over the renders in which it was visible.

    Args:
        count: number of Gaussians.
        device: device of the statistics.
    """

    def __init__(self, count: int, device: torch.device | None = None) -> None:
        self.total = torch.zeros(count, device=device)
        self.visible_count = torch.zeros(count, device=device)

    def add(self, screen: ScreenStatistics, side: int) -> None:
        """Add the statistics of one render.

        Args:
            screen: statistics, filled by the render and its backward.
            side: the image's longer side in pixels.
        """
        if screen.gradient is None or screen.visible is None:
            raise ValueError("screen statistics are filled by a render and its backward; neither has run")
        self.total += screen.gradient * screen.visible * (side / 2)
        self.visible_count += screen.visible

    def mean(self) -> Float[Tensor, " n"]:
        """Mean screen gradient; 0 for Gaussians that were never visible."""
        return self.total / self.visible_count.clamp(min=1)

    def state(self) -> dict[str, Tensor]:
        """State for a checkpoint."""
        return {"total": self.total, "times": self.visible_count}

    def restore(self, values: dict[str, Tensor]) -> None:
        """Restore a state that `state` returned."""
        self.total, self.visible_count = values["total"].clone(), values["times"].clone()


@torch.no_grad()
def densify(
    optimiser: SplatOptimiser,
    screen_gradients: ScreenGradientMean,
    settings: Densification,
    extent: float,
    limit: int,
    generator: torch.Generator,
) -> None:
    """Clone, split and prune once.

    Args:
        optimiser: the Gaussians and their moments; changed in place.
        screen_gradients: screen gradients since the last change.
        settings: thresholds.
        extent: camera extent in scene units.
        limit: largest number of Gaussians.
        generator: source of randomness for the positions of the halves.
    """
    gaussians = optimiser.gaussians()
    useful = ~_prune_mask(gaussians, settings, extent)
    allowed_growth = min(limit - int(useful.sum()), int(settings.growth * len(gaussians)) + 1)
    gradients = screen_gradients.mean()
    candidates = useful & (gradients > settings.pull)
    selected = _select_strongest(gradients, candidates, max(0, allowed_growth))
    is_large = gaussians.log_scales.exp().amax(1) > settings.small * extent
    gaussians = dataclasses.replace(
        gaussians, opacity_logits=torch.where(selected, _shared_opacity(gaussians), gaussians.opacity_logits)
    )
    clones, splits = gaussians[selected & ~is_large], gaussians[selected & is_large]
    halves = [_smaller_half(splits, generator) for _ in range(2)]
    optimiser.replace("opacity_logits", gaussians.opacity_logits)
    # A split Gaussian is removed and two halves are added, so cloning and splitting both add one.
    optimiser.keep(useful & ~(selected & is_large))
    for added in (clones, *halves):
        optimiser.append(added)


def _shared_opacity(gaussians: Gaussians) -> Float[Tensor, " n"]:
    """Logits of the opacity that two coincident Gaussians need to be as opaque as the original."""
    return torch.logit(1 - (1 - gaussians.opacity_logits.sigmoid()).sqrt(), eps=1e-6)


def _prune_mask(gaussians: Gaussians, settings: Densification, extent: float) -> Bool[Tensor, " n"]:
    """Mask of Gaussians that are nearly transparent or far too large."""
    transparent = gaussians.opacity_logits.sigmoid() < settings.opacity
    return transparent | (gaussians.log_scales.exp().amax(1) > settings.world_size * extent)


def _select_strongest(values: Tensor, candidates: Tensor, count: int) -> Bool[Tensor, " n"]:
    """Mask of the ``count`` candidates with the largest values."""
    selected = torch.zeros_like(candidates)
    indices = candidates.nonzero()[:, 0]
    order = values[indices].argsort(descending=True, stable=True)
    selected[indices[order[:count]]] = True
    return selected


def _smaller_half(parents: Gaussians, generator: torch.Generator) -> Gaussians:
    """One of two smaller Gaussians, its centre drawn from its parent's density."""
    scales = parents.log_scales.exp()
    offsets = torch.randn(scales.shape, generator=generator).to(scales) * scales
    means = parents.means + rotate_vectors(parents.quaternions, offsets)
    return dataclasses.replace(parents, means=means, log_scales=(scales / SPLIT_SHRINK).log())
