"""Padding, downscaling and upsampling of network inputs.

Axes: b batch, h height, w width.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.depth_normalisation import depth_unit
from gaussian_enhancer.network.halving import halved
from gaussian_enhancer.types import NetworkInput, usable


def padded(views: NetworkInput, stride: int) -> NetworkInput:
    """Views whose last row and column are repeated until both sides are multiples of a stride."""
    height, width = views.render.shape[-2:]
    bottom, right = -height % stride, -width % stride
    if bottom == 0 and right == 0:
        return views

    def grown(image: Tensor, finer: int) -> Tensor:
        below, beside = finer * bottom, finer * right
        flat = image.reshape(-1, *image.shape[-3:])
        if flat.shape[0] == 0:
            return image.new_zeros(*image.shape[:-2], image.shape[-2] + below, image.shape[-1] + beside)
        flat = F.pad(flat, (0, beside, 0, below), mode="replicate")
        return flat.reshape(*image.shape[:-2], *flat.shape[-2:])

    return views.mapped(grown)


def shrunk(views: NetworkInput, factor: int) -> NetworkInput:
    """Views averaged over squares of pixels; sides are multiples of the factor.

    References and their renders are averaged by visibility, depth as inverse depth where it is known. The unit of
    depth stays that of the full size.

    Args:
        views: at full size.
        factor: side of the squares in pixels.
    """
    if factor == 1:
        return views
    size = tuple(side // factor for side in views.render.shape[-2:])
    share = _averaged(views.visibility, factor, size)

    def seen(image: Tensor | None) -> Tensor | None:
        if image is None:
            return None
        return _averaged(image * views.visibility, factor, size) / share.clamp_min(1e-6) * (share > 0)

    depth, unit = views.depth, views.depth_unit
    if depth is not None:
        unit = depth_unit(depth) if unit is None else unit
        known = usable(depth)
        inverse = torch.where(known, 1 / torch.where(known, depth, torch.ones_like(depth)), torch.zeros_like(depth))
        mean, covered = _averaged(inverse, factor, size), _averaged(known.to(depth.dtype), factor, size)
        depth = torch.where(covered > 0, covered / torch.where(covered > 0, mean, torch.ones_like(mean)), 0.0)
    return NetworkInput(
        _averaged(views.render, factor, size),
        seen(views.references),  # type: ignore[arg-type]
        share,
        depth,
        None if views.alpha is None else _averaged(views.alpha, factor, size),
        unit,
        seen(views.reference_renders),
    )


def upsampled(image: Float[Tensor, "b c h w"], scale: int) -> Float[Tensor, "b c H W"]:
    """The image on a grid that is finer by a whole factor, bicubically; not clamped."""
    if scale == 1:
        return image
    return F.interpolate(image, scale_factor=scale, mode="bicubic", align_corners=False)


def _averaged(image: Tensor, factor: int, size: tuple[int, ...]) -> Tensor:
    if factor == 2:
        return halved(image)
    flat = image.reshape(-1, *image.shape[-3:])
    if flat.shape[0] == 0:
        return image.new_zeros(*image.shape[:-2], *size)
    flat = F.avg_pool2d(flat, factor)
    return flat.reshape(*image.shape[:-2], *flat.shape[-2:])
