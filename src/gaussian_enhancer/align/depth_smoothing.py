"""Smoothing of a splat's median depth, which jumps from Gaussian to Gaussian on smooth surfaces.

Axes: h height, w width.
"""

from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.projection import can_use_kernels, kernel_image

STEPS = (4, 2)
"""Pixels between the 5x5 samples of each pass, as in the a-trous transform; the widest pass is first."""
REACH = 2
"""Samples to each side."""
SPREAD = 0.03
"""Relative difference of inverse depth at which a sample's weight falls to a quarter; much more is another surface."""
CONTRAST = 0.1
"""Mean colour difference, in [0, 1], at which a sample's weight falls to a half."""
FURTHEST = 1e6
"""Samples nearer than the pixel by more than this factor weigh nothing; the bound keeps their products finite."""
RIDGE = 1e-3
"""Added to the slopes' part of the normal equations, in samples: where one pixel alone counts, its depth stays."""


def smooth_depth(depth: Float[Tensor, "1 h w"], render: Float[Tensor, "3 h w"]) -> Float[Tensor, "1 h w"]:
    """Depth of the plane that fits inverse depth best around each pixel.

    Planes are linear in inverse depth. Each pass fits one per pixel to 5x5 samples by least squares; a sample weighs
    1 / ((1 + (p / SPREAD)^2)^2 (1 + (c / CONTRAST)^2)), p being its inverse depth beyond the pixel's, relative to that,
    and c its mean colour difference: edges of depth and of colour stay. Scene units cancel.

    Args:
        depth: z, > 0 and finite.
        render: the colours that belong to it, [0, 1].
    """
    for step in STEPS:
        margin = (REACH * step,) * 4
        padded, colours = (F.pad(image[None], margin, mode="replicate")[0] for image in (depth, render.to(depth)))
        fit = _fit_planes_compiled if can_use_kernels(padded, colours) else fit_planes_torch
        depth = depth / (1 + fit(padded, colours, step))
    return depth


def fit_planes_torch(
    depth: Float[Tensor, "1 _ _"], render: Float[Tensor, "3 _ _"], step: int
) -> Float[Tensor, "1 h w"]:
    """Distance of each pixel's fitted plane beyond it, as a share of its inverse depth; readable twin of the kernel.

    Args:
        depth: z, with a margin of ``REACH`` samples on every side.
        render: colours, with the same margin.
        step: pixels between samples.
    """
    margin = REACH * step
    height, width = (side - 2 * margin for side in depth.shape[-2:])

    def at(image: Tensor, dy: int, dx: int) -> Tensor:
        top, left = margin + dy * step, margin + dx * step
        return image[:, top : top + height, left : left + width]

    centre, colour = at(depth, 0, 0), at(render, 0, 0)
    sums = [torch.zeros_like(centre) for _ in range(9)]
    for dy in range(-REACH, REACH + 1):
        for dx in range(-REACH, REACH + 1):
            beyond = (centre / at(depth, dy, dx) - 1).clamp_max(FURTHEST)
            contrast = (at(render, dy, dx) - colour).abs().mean(0, keepdim=True) / CONTRAST
            weight = 1 / ((1 + (beyond / SPREAD) ** 2) ** 2 * (1 + contrast**2))
            terms: tuple[Any, ...] = (1, dx, dy, dx * dx, dx * dy, dy * dy, beyond, dx * beyond, dy * beyond)
            sums = [total + weight * term for total, term in zip(sums, terms, strict=True)]
    one, x, y, xx, xy, yy, p, xp, yp = sums
    xx, yy = xx + RIDGE, yy + RIDGE
    area = xx * yy - xy * xy
    # The slopes are eliminated: what remains is one equation for the plane's height at the pixel.
    across, down = (x * yy - y * xy) / area, (y * xx - x * xy) / area
    return (p - across * xp - down * yp) / (one - across * x - down * y)


def _fit_planes_compiled(
    depth: Float[Tensor, "1 _ _"], render: Float[Tensor, "3 _ _"], step: int
) -> Float[Tensor, "1 h w"]:
    """The same by a compiled kernel."""
    from gaussian_enhancer.align.depth_smoothing_kernels import fit_planes
    from gaussian_enhancer.splat.compiled import kernel_lock

    height, width = (side - 2 * REACH * step for side in depth.shape[-2:])
    result = depth.new_empty(1, height, width)
    constants = (np.float32(value) for value in (1 / SPREAD, 1 / (3 * CONTRAST), RIDGE, FURTHEST))
    with kernel_lock:
        fit_planes(kernel_image(depth[0]), kernel_image(render), step, REACH, *constants, result[0].numpy())
    return result
