"""Degradation factors z: a latent code of the kind and the place of a render's degradation.

Axes: b batch, v vector entries, c grid channels, h height, w width of the image, i = ceil(h / 8), j = ceil(w / 8).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.degrade.artefacts.rng import normal
from gaussian_enhancer.types import Movable

CELL = 8
"""Side in pixels of a cell of the grid."""


@dataclass(frozen=True)
class Factors(Movable):
    """A latent code with a vector and a grid.

    DiffIR's code (Xia et al., ICCV 2023) is one vector per image, which describes how much an image is degraded but not
    where. The grid describes where. Either may have no entries.

    Args:
        vector: code of the whole image.
        grid: code of each cell of 8 x 8 pixels.
    """

    vector: Float[Tensor, "b v"]
    grid: Float[Tensor, "b c i j"]

    def linear_combination(self, other: "Factors", weight: float | Tensor, other_weight: float | Tensor) -> "Factors":
        """The sum weight * self + other_weight * other; weights may be tensors of shape (b,), one for each sample."""

        def scale(factor: float | Tensor, code: Tensor) -> Tensor:
            return code * (factor.view(-1, *[1] * (code.dim() - 1)) if isinstance(factor, Tensor) else factor)

        vector = scale(weight, self.vector) + scale(other_weight, other.vector)
        return Factors(vector, scale(weight, self.grid) + scale(other_weight, other.grid))


def grid_size(height: int, width: int) -> tuple[int, int]:
    """Rows and columns of the grid of an image."""
    return math.ceil(height / CELL), math.ceil(width / CELL)


def pad_to_cells(image: Float[Tensor, "b _ h w"]) -> Float[Tensor, "b _ _ _"]:
    """Pad an image to whole cells by repeating its last row and column."""
    height, width = image.shape[-2:]
    return F.pad(image, (0, -width % CELL, 0, -height % CELL), mode="replicate")


def white_noise(like: Factors, generators: Sequence[torch.Generator]) -> Factors:
    """Standard normal factors of the same shape, each sample's from its own generator.

    Args:
        like: factors with the shape, dtype and device of the result.
        generators: one for each sample.
    """
    vector = normal(like.vector.shape[1:], generators, like.vector)
    return Factors(vector, normal(like.grid.shape[1:], generators, like.grid))


class ZeroLayer(nn.Module):
    """Replaces a layer that reads from, or writes to, a part of z without entries; returns zeros.

    Args:
        channels: channels of the result.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.channels = channels

    def forward(self, x: Float[Tensor, "b _ ..."]) -> Float[Tensor, "b c ..."]:
        """Zeros with the batch and spatial sizes of x."""
        return x.new_zeros(x.shape[0], self.channels, *x.shape[2:])


def linear(inputs: int, outputs: int) -> nn.Module:
    """A linear layer, or `ZeroLayer` if either side has no entries."""
    return nn.Linear(inputs, outputs) if inputs and outputs else ZeroLayer(outputs)


def convolution(inputs: int, outputs: int, side: int) -> nn.Module:
    """A convolution that keeps the spatial size, or `ZeroLayer` if either side has no channels."""
    return nn.Conv2d(inputs, outputs, side, padding=side // 2) if inputs and outputs else ZeroLayer(outputs)
