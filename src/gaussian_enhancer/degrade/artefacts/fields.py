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
    """Fields with mean 0 and a standard deviation of about 1: normal numbers on a coarse grid, enlarged bicubically.

    Args:
        count: number of fields.
        cell: pixels between the coarse grid's points.
        height: in pixels.
        width: in pixels.
        generators: one for each sample.
        like: a tensor whose type and device the result has.
    """
    coarse = normal((count, math.ceil(height / cell) + 1, math.ceil(width / cell) + 1), generators, like)
    return F.interpolate(coarse, size=(height, width), mode="bicubic", align_corners=False)
