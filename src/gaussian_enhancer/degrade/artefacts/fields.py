"""Smooth fields over an image: random ones, and oriented Gaussians.

Axes: b batch, n fields, h height, w width.
"""

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import normal


def smooth_field(
    count: int, cell: int, height: int, width: int, generators: Sequence[torch.Generator], like: Tensor
) -> Float[Tensor, "b n h w"]:
    """Fields of mean 0 and standard deviation about 0.86: normal random numbers on a coarse grid, enlarged bicubically.

    Args:
        count: number of fields.
        cell: distance of the coarse grid's points in pixels.
        height: in pixels.
        width: in pixels.
        generators: one for each sample.
        like: a tensor with the dtype and device of the result.
    """
    coarse = normal((count, math.ceil(height / cell) + 1, math.ceil(width / cell) + 1), generators, like)
    return F.interpolate(coarse, size=(height, width), mode="bicubic", align_corners=False)


def oriented_gaussian(
    right: Float[Tensor, "..."],
    down: Float[Tensor, "..."],
    along: Float[Tensor, "..."],
    across: Float[Tensor, "..."],
    angle: Float[Tensor, "..."],
) -> Float[Tensor, "..."]:
    """Values of oriented Gaussians, 1 at their centres; the shapes of the arguments are broadcast.

    Args:
        right: x of positions relative to the centre, in pixels.
        down: y of positions relative to the centre, in pixels.
        along: standard deviation along the axis, in pixels.
        across: standard deviation perpendicular to it, in pixels.
        angle: angle between the axis and x, in radians.
    """
    cosine, sine = torch.cos(angle), torch.sin(angle)
    along_offset = (cosine * right + sine * down) / along
    across_offset = (cosine * down - sine * right) / across
    return torch.exp(-0.5 * (along_offset.square() + across_offset.square()))
