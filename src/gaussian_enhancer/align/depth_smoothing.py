"""Smoothing of a splat's median depth, which jumps from Gaussian to Gaussian on smooth surfaces.

Axes: h height, w width.
"""

from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.projection import can_use_kernels
from gaussian_enhancer.types import numpy_view

STEPS = (4, 2)
"""Pixels between the 5x5 samples of each pass, as in the a-trous transform, from the widest pass to the narrowest."""
WINDOW_RADIUS = 2
"""Number of samples on each side of a pixel."""
DEPTH_TOLERANCE = 0.03
"""Relative difference of inverse depth at which a sample's weight falls to 1/4; larger ones mean another surface."""
COLOUR_TOLERANCE = 0.1
"""Mean colour difference, in [0, 1], at which a sample's weight falls to 1/2."""
MAX_DEPTH_RATIO = 1e6
"""Samples closer to the camera than the pixel by more than this factor have almost no weight; clamping keeps products
finite."""
RIDGE = 1e-3
"""Added to the slopes' diagonal of the normal equations, in samples, so that a pixel without similar samples keeps its
depth."""


def smooth_depth(depth: Float[Tensor, "1 h w"], render: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 h w"]:
    """Smooth depth by fitting a plane to the inverse depth around each pixel.

    Planes are linear in inverse depth. Each pass fits one plane per pixel to 5x5 samples by least squares. A sample has
    the weight 1 / ((1 + (p / `DEPTH_TOLERANCE`)^2)^2 (1 + (c / `COLOUR_TOLERANCE`)^2)). Here p is the difference of its
    inverse depth from the pixel's, relative to the pixel's, and c is its mean colour difference. This preserves edges
    of depth and of colour. The result does not depend on scene units.

    Args:
        depth: z, positive and finite.
        render: colours of the same view, [0, 1].
    """
    for step in STEPS:
        margin = (WINDOW_RADIUS * step,) * 4
        padded, colours = (F.pad(image[None], margin, mode="replicate")[0] for image in (depth, render.to(depth)))
        fit = _fit_planes_compiled if can_use_kernels(padded, colours) else fit_planes_torch
        depth = depth / (1 + fit(padded, colours, step))
    return depth


def fit_planes_torch(
    depth: Float[Tensor, "1 _ _"], render: Float[Tensor, "3 _ _"], step: int
) -> Float[Tensor, "1 h w"]:
    """Offset of each pixel's fitted plane from its inverse depth, relative to that; readable twin of the kernel.

    Args:
        depth: z, with a margin of `WINDOW_RADIUS` samples on every side.
        render: colours, with the same margin.
        step: pixels between samples.
    """
    margin = WINDOW_RADIUS * step
    height, width = (side - 2 * margin for side in depth.shape[-2:])

    def at(image: Tensor, dy: int, dx: int) -> Tensor:
        top, left = margin + dy * step, margin + dx * step
        return image[:, top : top + height, left : left + width]

    centre, colour = at(depth, 0, 0), at(render, 0, 0)
    sums = [torch.zeros_like(centre) for _ in range(9)]
    for dy in range(-WINDOW_RADIUS, WINDOW_RADIUS + 1):
        for dx in range(-WINDOW_RADIUS, WINDOW_RADIUS + 1):
            offset = (centre / at(depth, dy, dx) - 1).clamp_max(MAX_DEPTH_RATIO)
            contrast = (at(render, dy, dx) - colour).abs().mean(0, keepdim=True) / COLOUR_TOLERANCE
            weight = 1 / ((1 + (offset / DEPTH_TOLERANCE) ** 2) ** 2 * (1 + contrast**2))
            terms: tuple[Any, ...] = (1, dx, dy, dx * dx, dx * dy, dy * dy, offset, dx * offset, dy * offset)
            sums = [total + weight * term for total, term in zip(sums, terms, strict=True)]
    count, x, y, xx, xy, yy, p, xp, yp = sums
    xx, yy = xx + RIDGE, yy + RIDGE
    area = xx * yy - xy * xy
    # With the slopes eliminated, one equation remains for the plane's offset at the pixel.
    across, down = (x * yy - y * xy) / area, (y * xx - x * xy) / area
    return (p - across * xp - down * yp) / (count - across * x - down * y)


def _fit_planes_compiled(
    depth: Float[Tensor, "1 _ _"], render: Float[Tensor, "3 _ _"], step: int
) -> Float[Tensor, "1 h w"]:
    """Compiled version of `fit_planes_torch`."""
    from gaussian_enhancer.align.depth_smoothing_kernels import fit_planes
    from gaussian_enhancer.compiled import kernel_lock

    height, width = (side - 2 * WINDOW_RADIUS * step for side in depth.shape[-2:])
    result = depth.new_empty(1, height, width)
    constants = (
        np.float32(value) for value in (1 / DEPTH_TOLERANCE, 1 / (3 * COLOUR_TOLERANCE), RIDGE, MAX_DEPTH_RATIO)
    )
    with kernel_lock:
        fit_planes(numpy_view(depth[0]), numpy_view(render), step, WINDOW_RADIUS, *constants, result[0].numpy())
    return result
