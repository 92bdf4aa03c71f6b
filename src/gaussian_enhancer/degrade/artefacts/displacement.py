"""Displacement: pixels are sampled at offset positions, imitating splats at a wrong depth.

Axes: b batch, c channels, h height, w width, 2 (x, y) in pixels.
"""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.fields import smooth_field
from gaussian_enhancer.degrade.artefacts.rng import normal, uniform
from gaussian_enhancer.degrade.artefacts.view import View, per_sample

SMOOTH_FACTOR = 1.2
"""Factor in pixels of the smooth field at strength 1, for a displacement with a standard deviation of 1.0 pixel."""

CELL = 24
JUMP_SHARE = 0.03
"""Share of the pixels with an additional random jump, at strength 1."""

JUMP_SIGMA = 1.5
"""Standard deviation of the jumps before rounding to whole pixels, in pixels."""


def displace(
    planes: Float[Tensor, "b c h w"], offset: Float[Tensor, "b 2 h w"], mode: str = "bilinear"
) -> Float[Tensor, "b c h w"]:
    """Sample planes at p + offset(p); the border's pixels are repeated outside.

    Args:
        planes: planes to sample.
        offset: x and y, in pixels.
        mode: "bilinear" or "nearest".
    """
    height, width = planes.shape[-2:]
    y = torch.arange(height, device=offset.device, dtype=offset.dtype)[:, None]
    x = torch.arange(width, device=offset.device, dtype=offset.dtype)
    grid = torch.stack([(2 * (x + offset[:, 0]) + 1) / width - 1, (2 * (y + offset[:, 1]) + 1) / height - 1], dim=-1)
    return F.grid_sample(planes, grid, mode=mode, padding_mode="border", align_corners=False)


def random_offset(
    strength: Float[Tensor, " b"], generators: Sequence[torch.Generator], like: Float[Tensor, "b c h w"]
) -> Float[Tensor, "b 2 h w"]:
    """A smooth displacement with a standard deviation of 1.0 pixel, plus jumps by whole pixels at 3% of the pixels.

    These values hold for strength 1. The smooth displacement and the share of jumping pixels are proportional to the
    strength. A pixel that jumps at a small strength jumps by the same offset at a larger one.

    Args:
        strength: strength for each sample, [0, 1].
        generators: one for each sample.
        like: a tensor with the size, dtype and device of the result.
    """
    height, width = like.shape[-2:]
    smooth = SMOOTH_FACTOR * per_sample(strength) * smooth_field(2, CELL, height, width, generators, like)
    jumps = uniform(0.0, 1.0, (1, height, width), generators, like) < JUMP_SHARE * per_sample(strength)
    return smooth + jumps * (JUMP_SIGMA * normal((2, height, width), generators, like)).round()


def displacement(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Displace pixels by a smooth field, and single pixels by a jump; image, depth and opacity move together.

    The jumps are the re-positioning of NeRFLiX (Zhou et al., CVPR 2023). The smooth field imitates the effect of splats
    at a wrong depth. Depth is sampled without interpolation: the mean of two surfaces' depths lies on neither.
    """
    offset = random_offset(strength, generators, view.image)
    moved = (offset != 0).any(dim=1, keepdim=True)

    def displaced(plane: Tensor, mode: str = "bilinear") -> Tensor:
        # Sampling with offset 0 has rounding errors: pixels that do not move are copied instead.
        return torch.where(moved, displace(plane, offset, mode), plane)

    depth = None if view.depth is None else displaced(view.depth, "nearest")
    alpha = None if view.alpha is None else displaced(view.alpha)
    return View(displaced(view.image), depth, alpha)
