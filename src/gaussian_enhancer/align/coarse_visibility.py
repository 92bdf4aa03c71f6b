"""Coarse visibility of candidate references, used to select those that are warped at full size.

The warp is that of the reference configuration, on images of about 64 pixels, at 1/100 of the cost.
Axes: h height, w width of the target; p, q of a reference.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.alignment import AlignedReferences, LoadedView, Reprojected

EDGE = 64
"""Longer side of the coarse grid in pixels."""


def coarse_visibility(warp: Reprojected, target: LoadedView, candidates: Sequence[LoadedView]) -> AlignedReferences:
    """Warp all candidates to the target's coarse grid, in the order in which the full warp ranks them.

    Args:
        warp: the warp of the reference configuration; its depth search is disabled here.
        target: target with camera and depth, from `coarsen`.
        candidates: references with cameras, from `coarsen`.
    """
    return replace(warp, depth="exact")(target, candidates, len(candidates))


def visible_shares(aligned: AlignedReferences, alpha: Float[Tensor, "1 h w"] | None) -> dict[str, float]:
    """Share of the target's visible surface that each candidate shows, in [0, 1], in the order of ``aligned``.

    Args:
        aligned: result of `coarse_visibility`.
        alpha: opacity of the target on the same grid; None counts each pixel fully.
    """
    height, width = aligned.visibility.shape[-2:]
    total = float(height * width if alpha is None else alpha.clamp(0, 1).sum())
    shares = (aligned.visibility.sum((1, 2, 3)) / max(total, 1e-6)).clamp(0, 1).tolist()
    return dict(zip(aligned.names, shares, strict=True))


def coarsen(pixels: LoadedView) -> LoadedView:
    """A view on a coarse grid. Colours are averaged; depth and opacity are sampled at pixels, so no surfaces mix."""

    def resize(image: Float[Tensor, "c _ _"], *, averaged: bool) -> Float[Tensor, "c _ _"]:
        shrink = max(1.0, max(image.shape[-2:]) / EDGE)
        size = [max(1, round(side / shrink)) for side in image.shape[-2:]]
        if averaged:
            return F.interpolate(image[None], size=size, mode="area")[0]
        return F.interpolate(image[None], size=size, mode="nearest-exact")[0]

    image = resize(pixels.image, averaged=True)
    return replace(
        pixels,
        image=image,
        camera=None if pixels.camera is None else pixels.camera.resized(*image.shape[-2:]),
        depth=None if pixels.depth is None else resize(pixels.depth, averaged=False),
        alpha=None if pixels.alpha is None else resize(pixels.alpha, averaged=False),
        render=None if pixels.render is None else resize(pixels.render, averaged=True),
        read_fine=None,
    )
