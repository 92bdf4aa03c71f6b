"""Large empty areas beside a splat, which stay as they were rendered.

A camera that looks past the edge of a splat sees nothing there, and no reference shows anything. The network learnt to
fill small holes; over large empty areas it draws a texture of its own.
Axes: b batch, r references, h height, w width.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.types import NetworkInput

EMPTY_OPACITY = 0.3
"""Opacity below which a pixel that no reference shows counts as empty."""
SURFACE_OPACITY = 0.9
"""Opacity from which on a pixel counts as a surface and keeps its change; between both, the render is blended in."""
CORE, CORE_SHARE = 25, 0.8
"""Side in pixels of a window, and the share of empty pixels in it from which on its centre lies in a large area."""
SMALL_SHARE, LARGE_SHARE = 0.005, 0.025
"""Shares of a view that such centres cover: up to the first nothing is restored, from the second on everything.

Held-out views of validation captures have at most 0.0023: there the network's fill is nearer to the photo than black.
"""
REACH = 61
"""Side in pixels of the window over which a large area extends to its surroundings, and over which it fades out."""


def restore_empty_areas(enhanced: Float[Tensor, "b 3 h w"], views: NetworkInput) -> Float[Tensor, "b 3 h w"]:
    """Return the render in and near large empty areas, at pixels that no reference shows.

    Args:
        enhanced: the enhanced image.
        views: the render, its opacity and the references' visibility; without opacity nothing is changed.
    """
    if views.alpha is None:
        return enhanced
    unseen = ~(views.visibility > 0).any(1)
    empty = (unseen & (views.alpha < EMPTY_OPACITY)).to(enhanced.dtype)
    if float(empty.mean()) <= SMALL_SHARE:
        return enhanced
    core = (_window_mean(empty, CORE) > CORE_SHARE).to(enhanced.dtype)
    strength = ((core.mean((1, 2, 3), keepdim=True) - SMALL_SHARE) / (LARGE_SHARE - SMALL_SHARE)).clamp(0, 1)
    if not bool(strength.any()):
        return enhanced
    half = REACH // 2
    near = F.max_pool2d(F.max_pool2d(core, (REACH, 1), 1, (half, 0)), (1, REACH), 1, (0, half))
    transparency = ((SURFACE_OPACITY - views.alpha) / (SURFACE_OPACITY - EMPTY_OPACITY)).clamp(0, 1)
    weight = strength * _window_mean(near, REACH) * transparency * unseen
    return torch.lerp(enhanced, views.render.to(enhanced.dtype), weight)


def _window_mean(image: Float[Tensor, "b 1 h w"], side: int) -> Float[Tensor, "b 1 h w"]:
    """Mean over a square window, inside the image."""
    half = side // 2
    rows = F.avg_pool2d(image, (side, 1), 1, (half, 0), count_include_pad=False)
    return F.avg_pool2d(rows, (1, side), 1, (0, half), count_include_pad=False)
