"""Removing floaters: Gaussians in space that photos and depth maps of several training views say is empty.

Axes: n Gaussians, v views, h height, w width.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.rendered_capture import SplatRenderer
from gaussian_enhancer.scene.scene import Photo
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.typed import check_fields
from gaussian_enhancer.types import Camera

Share = Annotated[int | float, Field(ge=0, le=1)]
PROBES = 4
"""Backward passes with random signs a view."""
SHARES = tuple(0.5**halvings for halvings in range(8))
"""Of the Gaussians that may go, the ones with the clearest evidence; the share is taken that suits the photos best."""


@dataclass(frozen=True)
class PruneSettings:
    """What counts as evidence that space is empty.

    Args:
        views: training views that must see through a Gaussian's centre to a surface behind it, at least.
        margin: how far behind it, as a share of its depth.
        agreement: how far views agree that a Gaussian makes things worse, from 0 to 1 where all do; and share of the
            views of its place that must see through it.
        loss: decibels that the training views' mean PSNR may fall by at most; else none is removed.
    """

    views: Annotated[int, Field(ge=1)] = 3
    margin: Annotated[int | float, Field(gt=0)] = 0.1
    agreement: Share = 0.8
    loss: Annotated[int | float, Field(ge=0)] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "prune.")


@dataclass(frozen=True)
class Pruned:
    """What was removed.

    Args:
        kept: mask of the Gaussians that stay.
        suspected: how many the evidence spoke against.
        before: mean PSNR of the training views in dB.
        after: the same without the removed ones.
    """

    kept: Bool[Tensor, " n"]
    suspected: int
    before: float
    after: float

    def __str__(self) -> str:
        removed = int((~self.kept).sum())
        text = f"{removed} of {len(self.kept)} Gaussians removed as floaters, {self.suspected} suspected"
        return f"{text}; training PSNR {self.before:.3f} -> {self.after:.3f} dB"


def prune(renderer: SplatRenderer, photos: Sequence[Photo], settings: PruneSettings) -> Pruned:
    """Find the Gaussians that photos contradict and that depth maps see through.

    Removing one Gaussian changes a pixel by the derivative of its colour in the Gaussian's opacity, times that opacity:
    blending is affine in each. With d this change and e the pixel's error, the squared error of a view changes by the
    sum of 2 e d + d^2. One backward pass a view tells the first part of every Gaussian, one with random signs in place
    of the error an estimate of the second (Hutchinson's). Contradicted is a Gaussian without which the error falls, and
    whose first part has one sign in nearly all views that show it. Depth maps are rendered without these; a floater is
    one whose place they see through.

    Args:
        renderer: the splat and how it is rendered.
        photos: the training photos, with cameras.
        settings: what counts as evidence.

    Raises:
        InputError: a photo cannot be read or has no camera.
    """
    gain, agreed = _error_reductions(renderer, photos)
    gaussians = renderer.gaussians
    contradicted = (gain > 0) & (agreed >= settings.agreement)
    through, met = _seen_through(
        replace(renderer, gaussians=gaussians[~contradicted]), gaussians.means, photos, settings.margin
    )
    empty = (through >= settings.views) & (through >= settings.agreement * (through + met))
    suspects = contradicted & empty
    before = _psnr(renderer, photos)
    order = torch.where(suspects, gain, -1.0).argsort(descending=True, stable=True)
    count = int(suspects.sum())
    tried = {max(1, round(share * count)) for share in SHARES} if count else set()
    results = {number: _psnr(_render_without(renderer, order[:number]), photos) for number in sorted(tried)}
    best = max(results, key=results.__getitem__, default=0)
    kept_mask = torch.ones_like(suspects)
    if not best or results[best] < before - settings.loss:
        return Pruned(kept_mask, count, before, before)
    kept_mask[order[:best]] = False
    return Pruned(kept_mask, count, before, results[best])


def _render_without(renderer: SplatRenderer, index: Tensor) -> SplatRenderer:
    kept_mask = torch.ones(len(renderer.gaussians), dtype=torch.bool, device=index.device)
    kept_mask[index] = False
    return replace(renderer, gaussians=renderer.gaussians[kept_mask])


def _error_reductions(
    renderer: SplatRenderer, photos: Sequence[Photo]
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """By how much the squared error falls without each Gaussian, and how far views agree on it, from -1 to 1."""
    first = torch.zeros_like(renderer.gaussians.opacity_logits)
    absolute, second = torch.zeros_like(first), torch.zeros_like(first)
    transmittance = (1 - renderer.gaussians.opacity_logits.sigmoid()).clamp_min(1e-6)
    generator = torch.Generator().manual_seed(0)
    for camera, photo in _posed(photos):
        logits = renderer.gaussians.opacity_logits.clone().requires_grad_()
        shown = replace(renderer.gaussians, opacity_logits=logits)
        colour = render(shown, camera, renderer.method, renderer.background, near=renderer.near).colour
        error = (colour - photo.read().to(colour)).square().sum()
        (fall,) = torch.autograd.grad(error, logits, retain_graph=True)
        first += fall / transmittance
        absolute += (fall / transmittance).abs()
        for _ in range(PROBES):
            signs = (2 * torch.randint(2, colour.shape, generator=generator) - 1).to(colour)
            (change,) = torch.autograd.grad((colour * signs).sum(), logits, retain_graph=True)
            second += (change / transmittance).square() / PROBES
    return first - second, first / absolute.clamp_min(1e-12)


def _seen_through(
    renderer: SplatRenderer, places: Float[Tensor, "n 3"], photos: Sequence[Photo], margin: int | float
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """In how many views the surface lies behind each place, and in how many at it."""
    through = torch.zeros(len(places))
    met = torch.zeros(len(places))
    centres = places.cpu()
    for camera, _ in _posed(photos):
        surface = renderer(camera).surface[0]
        depth, pixel, inside = _project(centres, camera, renderer.near)
        surface_depth = torch.where(inside, surface.flatten()[pixel], 0.0)
        through += (surface_depth > depth * (1 + margin)) & inside
        met += (surface_depth > depth * (1 - margin)) & (surface_depth <= depth * (1 + margin)) & inside
    return through.to(places), met.to(places)


def _project(
    places: Float[Tensor, "n 3"], camera: Camera, near: float
) -> tuple[Float[Tensor, " n"], Tensor, Bool[Tensor, " n"]]:
    """Depth of each place, the number of its pixel, and whether it lies in the image."""
    points = places @ camera.rotation.T.cpu() + camera.world_to_camera[:3, 3].cpu()
    depth = points[:, 2]
    pixels = (points @ camera.K.T.cpu())[:, :2] / depth[:, None].clamp_min(near)
    x, y = pixels.nan_to_num(-1).clamp(-1, 2**20).floor().long().unbind(1)
    inside = (depth > near) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    return depth, torch.where(inside, y * camera.width + x, 0), inside


def _psnr(renderer: SplatRenderer, photos: Sequence[Photo]) -> float:
    errors = []
    for camera, photo in _posed(photos):
        errors.append(float((renderer(camera).colour.clamp(0, 1) - photo.read()).square().mean()))
    return float(-10 * torch.tensor(errors).clamp_min(1e-10).log10().mean())


def _posed(photos: Sequence[Photo]) -> Iterator[tuple[Camera, Photo]]:
    for photo in photos:
        if photo.camera is None:
            raise InputError(f"photo {photo.name}", "has no camera", "give its camera, or leave the photo out")
        yield photo.camera, photo
