"""Limits to the change that super-resolution makes beyond the render's resolution.

Axes: b batch, r references, h height, w width, H and W multiples of h and w.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.network.colour_clamping import clamp_to_references
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.types import NetworkInput

STRIP = 64
"""Rows of the render that are limited at a time, so that large images need little memory."""
HALO = 2
"""Rows beyond a strip that bicubic upsampling reads."""


def limit_finer_scales(
    finer: Float[Tensor, "b 3 H W"], image: Float[Tensor, "b 3 h w"], views: NetworkInput, clamps: bool = True
) -> Float[Tensor, "b 3 H W"]:
    """Limit a super-resolved image to what the fine references show.

    Each pixel that a reference sees is clamped to the range of the bicubically upsampled image and of the fine
    references at this pixel: finer scales may choose among the photos' detail but not exceed it. Where no reference is
    visible, the finer scales have nothing to read and can make patterns of their own; there the result is the upsampled
    image.

    Args:
        finer: the super-resolved image, at a multiple of the image's size; it is changed in place.
        image: the image that was super-resolved.
        views: its references. Between pixels that a reference sees and others, the two images are blended over 3x3
            pixels of the smaller one. Without fine references nothing is clamped.
        clamps: whether to clamp pixels that a reference sees.
    """
    photos = views.fine_references if clamps else None
    seen = (views.visibility > 0).any(1).to(image)
    if photos is None and bool(seen.all()):
        return finer
    scale, height = finer.shape[-1] // image.shape[-1], image.shape[-2]
    share = F.avg_pool2d(seen, 3, stride=1, padding=1, count_include_pad=False)
    share = F.interpolate(share, scale_factor=scale, mode="bilinear", align_corners=False)
    for top in range(0, height, STRIP):
        bottom = min(top + STRIP, height)
        rows = slice(scale * top, scale * bottom)
        first = max(0, top - HALO)
        upsampled = upsample_bicubic(image[..., first : bottom + HALO, :], scale)
        upsampled = upsampled[..., scale * (top - first) : scale * (bottom - first), :]
        strip = finer[..., rows, :]
        if photos is not None:
            visibility = views.visibility[..., top:bottom, :].repeat_interleave(scale, -2).repeat_interleave(scale, -1)
            limits = NetworkInput(upsampled, photos[..., rows, :].to(upsampled), visibility)
            strip = clamp_to_references(strip, limits, window=1)
        torch.lerp(upsampled, strip, share[..., rows, :], out=finer[..., rows, :])
    return finer
