"""Removal of floaters: Gaussians in space that is empty according to photos and depth maps of several training views.

Axes: n Gaussians, v views, h height, w width.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from gaussian_enhancer.runs.rendered_capture import SplatRenderer
from gaussian_enhancer.scene.scene import Photo
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.typed import Share, check_fields
from gaussian_enhancer.types import Camera

PROBES = 4
"""Number of backward passes with random signs per view."""
SHARES = tuple(0.5**halvings for halvings in range(8))
"""Shares of the suspected Gaussians, strongest evidence first, that are tried; the one of highest PSNR is removed."""


@dataclass(frozen=True)
class PruneSettings:
    """Criteria by which Gaussians are floaters.

    Args:
        views: smallest number of training views whose depth map shows a surface behind a Gaussian's centre.
        margin: distance by which the surface must be behind the centre, as a share of the centre's depth.
        agreement: threshold of two values: the agreement of views that a Gaussian increases the error, 1 where all
            agree; and the share of views with the surface behind the centre in those with the surface at or behind it.
        loss: largest permitted decrease of the training views' mean PSNR in dB; with a larger one, nothing is removed.
    """

    views: Annotated[int, Field(ge=1)] = 3
    margin: Annotated[int | float, Field(gt=0)] = 0.1
    agreement: Share = 0.8
    loss: Annotated[int | float, Field(ge=0)] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "prune.")


@dataclass(frozen=True)
class PruneResult:
    """Result of pruning.

    Args:
        kept: mask of the Gaussians that stay.
        suspected: number of Gaussians that meet the criteria.
        before: mean PSNR of the training views in dB.
        after: the same without the removed Gaussians.
    """

    kept: Bool[Tensor, " n"]
    suspected: int
    before: float
    after: float

    def __str__(self) -> str:
        removed = int((~self.kept).sum())
        text = f"{removed} of {len(self.kept)} Gaussians removed as floaters, {self.suspected} suspected"
        return f"{text}; training PSNR {self.before:.3f} -> {self.after:.3f} dB"


def prune(renderer: SplatRenderer, photos: Sequence[Photo], settings: PruneSettings) -> PruneResult:
    """Find floaters: Gaussians that photos contradict and whose centres are in front of the surface in depth maps.

    Blending is affine in each Gaussian's opacity. So the removal of one Gaussian changes a pixel's colour by d, the
    negative opacity times the derivative of the colour in the opacity. With e the pixel's error, the squared error of a
    view changes by the sum of 2 e d + d^2. One backward pass per view gives the first term for every Gaussian. Backward
    passes with random signs in place of the error give an estimate of the second term (Hutchinson's). Photos contradict
    a Gaussian if the error decreases without it, and the first term has the same sign in nearly all views that show it.
    Depth maps are rendered without these Gaussians. A floater is one of them whose centre is in front of the surface in
    enough views.

    Floaters are sorted by the decrease of the error. Several shares of them are removed on trial, and the share with
    the highest training PSNR is chosen.

    Args:
        renderer: renderer of the splat.
        photos: training photos, with cameras.
        settings: criteria.

    Raises:
        InputError: a photo cannot be read or has no camera.
    """
    gain, agreement = _error_reductions(renderer, photos)
    gaussians = renderer.gaussians
    contradicted = (gain > 0) & (agreement >= settings.agreement)
    behind, at_surface = _count_surface_views(
        replace(renderer, gaussians=gaussians[~contradicted]), gaussians.means, photos, settings.margin
    )
    in_front = (behind >= settings.views) & (behind >= settings.agreement * (behind + at_surface))
    suspects = contradicted & in_front
    psnr_before = _psnr(renderer, photos)
    order = torch.where(suspects, gain, -1.0).argsort(descending=True, stable=True)
    count = int(suspects.sum())
    counts = {max(1, round(share * count)) for share in SHARES} if count else set()
    kept_masks = {c: torch.ones_like(suspects).index_fill(0, order[:c], False) for c in sorted(counts)}
    psnrs = {c: _psnr(replace(renderer, gaussians=gaussians[kept]), photos) for c, kept in kept_masks.items()}
    best_count = max(psnrs, key=psnrs.__getitem__, default=0)
    if not best_count or psnrs[best_count] < psnr_before - settings.loss:
        return PruneResult(torch.ones_like(suspects), count, psnr_before, psnr_before)
    return PruneResult(kept_masks[best_count], count, psnr_before, psnrs[best_count])


def _error_reductions(
    renderer: SplatRenderer, photos: Sequence[Photo]
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Decrease of the squared error by removal of each Gaussian, and agreement of the views on its sign, in [-1, 1]."""
    first_order = torch.zeros_like(renderer.gaussians.opacity_logits)
    absolute_first_order, second_order = torch.zeros_like(first_order), torch.zeros_like(first_order)
    transmittance = (1 - renderer.gaussians.opacity_logits.sigmoid()).clamp_min(1e-6)
    generator = torch.Generator().manual_seed(0)
    for photo in photos:
        camera = photo.require_camera()
        logits = renderer.gaussians.opacity_logits.clone().requires_grad_()
        gaussians = replace(renderer.gaussians, opacity_logits=logits)
        colour = render(gaussians, camera, renderer.method, renderer.background, near=renderer.near).colour
        error = (colour - photo.read().to(colour)).square().sum()
        (gradient,) = torch.autograd.grad(error, logits, retain_graph=True)
        first_order += gradient / transmittance
        absolute_first_order += (gradient / transmittance).abs()
        for _ in range(PROBES):
            signs = (2 * torch.randint(2, colour.shape, generator=generator) - 1).to(colour)
            (probe_gradient,) = torch.autograd.grad((colour * signs).sum(), logits, retain_graph=True)
            second_order += (probe_gradient / transmittance).square() / PROBES
    return first_order - second_order, first_order / absolute_first_order.clamp_min(1e-12)


def _count_surface_views(
    renderer: SplatRenderer, positions: Float[Tensor, "n 3"], photos: Sequence[Photo], margin: int | float
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Number of views whose surface is behind each position, and number of views whose surface is at it."""
    behind, at_surface = torch.zeros(len(positions)), torch.zeros(len(positions))
    points = positions.cpu()
    for photo in photos:
        camera = photo.require_camera()
        surface = renderer(camera).surface[0]
        depth, pixel, inside = _project(points, camera, renderer.near)
        surface_depth = torch.where(inside, surface.flatten()[pixel], 0.0)
        behind += (surface_depth > depth * (1 + margin)) & inside
        at_surface += (surface_depth > depth * (1 - margin)) & (surface_depth <= depth * (1 + margin)) & inside
    return behind.to(positions), at_surface.to(positions)


def _project(
    positions: Float[Tensor, "n 3"], camera: Camera, near: float
) -> tuple[Float[Tensor, " n"], Tensor, Bool[Tensor, " n"]]:
    """Depth of each position, index of its pixel, and whether it projects into the image."""
    points = positions @ camera.rotation.T.cpu() + camera.world_to_camera[:3, 3].cpu()
    depth = points[:, 2]
    pixels = (points @ camera.K.T.cpu())[:, :2] / depth[:, None].clamp_min(near)
    x, y = pixels.nan_to_num(-1).clamp(-1, 2**20).floor().long().unbind(1)
    inside = (depth > near) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    return depth, torch.where(inside, y * camera.width + x, 0), inside


def _psnr(renderer: SplatRenderer, photos: Sequence[Photo]) -> float:
    """Mean PSNR of the photos' renders in dB."""
    errors = [
        float((renderer(photo.require_camera()).colour.clamp(0, 1) - photo.read()).square().mean()) for photo in photos
    ]
    return float(-10 * torch.tensor(errors).clamp_min(1e-10).log10().mean())
