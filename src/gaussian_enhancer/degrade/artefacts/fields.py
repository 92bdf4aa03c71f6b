"""Smooth random fields over an image.

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
    """Fields of mean 0 and standard deviation about 1: normal random numbers on a coarse grid, enlarged bicubically.

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
