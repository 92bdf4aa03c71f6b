"""3-vectors: the type of literal ones, and operations on tensors of them, written out.

Torch's reductions over an axis of size 3 are ten times slower on the CPU.
Axes: m samples, c components.
"""

import torch
from jaxtyping import Float
from torch import Tensor

Number = float | int
Vector = tuple[Number, Number, Number]


def dot(a: Float[Tensor, "m 3"], b: Float[Tensor, "m 3"]) -> Float[Tensor, " m"]:
    """Dot product of each pair of rows."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def unit(a: Float[Tensor, "m 3"]) -> Float[Tensor, "m 3"]:
    """Normalise each row to unit length."""
    return a * torch.rsqrt(dot(a, a).clamp_min(1e-24))[:, None]


def interpolate_corners(weights: Float[Tensor, "m 3"], corners: Float[Tensor, "m 3 c"]) -> Float[Tensor, "m c"]:
    """Interpolate values at three corners by barycentric weights."""
    return (
        weights[:, 0, None] * corners[:, 0] + weights[:, 1, None] * corners[:, 1] + weights[:, 2, None] * corners[:, 2]
    )
