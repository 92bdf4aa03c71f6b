"""Local strength of detail, regardless of content: simulated and real renders must agree in it.

Axes: b batch, c channels, h height, w width, i = ceil(h / 8), j = ceil(w / 8).
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.generative.factors import CELL, pad_to_cells

OCTAVES = 3
"""Octaves of detail that are distinguished: of 1, 2 and 4 pixels."""

FAINT = 1e-5
"""Energy below which amplitudes count as none, colours in [0, 1]."""


def octaves(image: Float[Tensor, "b c h w"]) -> list[Float[Tensor, "b c h w"]]:
    """Detail of an image by octave, finest first: differences of ever coarser versions of it.

    Args:
        image: with sides that are multiples of 2 ** `OCTAVES`.
    """
    found, finer, small = [], image, image
    for _ in range(OCTAVES):
        small = F.avg_pool2d(small, 2)
        coarser = F.interpolate(small, size=image.shape[-2:], mode="bilinear", align_corners=False)
        found.append(finer - coarser)
        finer = coarser
    return found


def amplitudes(image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b _ i j"]:
    """Root mean squares, over cells of 8 x 8 pixels, of each octave of detail and of differences along x and along y.

    Args:
        image: colours.
    """
    whole = pad_to_cells(image)
    right = F.pad(whole[..., :, 1:] - whole[..., :, :-1], (0, 1))
    down = F.pad(whole[..., 1:, :] - whole[..., :-1, :], (0, 0, 0, 1))
    energies = torch.cat([*octaves(whole), right, down], dim=1).square()
    return (F.avg_pool2d(energies, CELL) + FAINT).sqrt()


def texture_difference(made: Float[Tensor, "b c h w"], real: Float[Tensor, "b c h w"]) -> Float[Tensor, ""]:
    """Mean absolute difference of amplitudes: sharpness and direction of detail, not its place.

    A mean of several possible textures is blurred and wins every comparison pixel by pixel; here it loses.

    Args:
        made: simulated.
        real: of the same view.
    """
    return (amplitudes(made.float()) - amplitudes(real.float())).abs().mean()
