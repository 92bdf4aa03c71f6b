"""Local strength of detail, independent of content, by which simulated and real renders are compared.

Axes: b batch, c channels, h height, w width, i = ceil(h / 8), j = ceil(w / 8).
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.generative.factors import CELL, pad_to_cells

OCTAVES = 3
"""Number of octaves of detail: of 1, 2 and 4 pixels."""

FAINT = 1e-5
"""Energy that is added below the root, so that faint detail hardly matters; for colours in [0, 1]."""


def octaves(image: Float[Tensor, "b c h w"]) -> list[Float[Tensor, "b c h w"]]:
    """Octaves of an image's detail, finest first: differences between successively coarser versions.

    Args:
        image: image whose sides are multiples of 2 ** `OCTAVES`.
    """
    details, finer, downsampled = [], image, image
    for _ in range(OCTAVES):
        downsampled = F.avg_pool2d(downsampled, 2)
        coarser = F.interpolate(downsampled, size=image.shape[-2:], mode="bilinear", align_corners=False)
        details.append(finer - coarser)
        finer = coarser
    return details


def amplitudes(image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b _ i j"]:
    """Root mean squares over cells of 8 x 8 pixels of each octave of detail, and of differences along x and along y.

    Args:
        image: colours.
    """
    padded = pad_to_cells(image)
    right = F.pad(padded[..., :, 1:] - padded[..., :, :-1], (0, 1))
    down = F.pad(padded[..., 1:, :] - padded[..., :-1, :], (0, 0, 0, 1))
    energies = torch.cat([*octaves(padded), right, down], dim=1).square()
    return (F.avg_pool2d(energies, CELL) + FAINT).sqrt()


def texture_difference(simulated: Float[Tensor, "b c h w"], real: Float[Tensor, "b c h w"]) -> Float[Tensor, ""]:
    """Mean absolute difference of amplitudes, which compares sharpness and direction of detail but not its position.

    The mean of several possible textures is blurred. It is the best in pixel-wise comparisons, but not in this one.

    Args:
        simulated: simulated renders.
        real: real renders of the same views.
    """
    return (amplitudes(simulated.float()) - amplitudes(real.float())).abs().mean()
