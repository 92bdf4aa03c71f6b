"""Floaters: compact blobs near the camera, where no training view contradicts them.

Axes: b batch, k splats.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import uniform
from gaussian_enhancer.degrade.artefacts.splats import SplatLayer, colour_at, composite, depth_level
from gaussian_enhancer.degrade.artefacts.view import View

FLOATERS = 6
"""Blobs of a sample at most; one is always there."""


def floater(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Soft blobs at 10 to 40% of the median depth, coloured from anywhere in the image, or dark, or bright.

    Standard deviations are 3 to 12% of the image's side; opacity grows with strength, to 0.15 to
    0.9, and is seldom large: what is opaque in some training view was removed by the fit.

    Args:
        view: what is degraded.
        strength: of each sample, [0, 1].
        generators: one for each sample.
    """
    height, width = view.image.shape[-2:]
    size, side = view.image.new_tensor([width, height]), math.sqrt(height * width)
    chance = uniform(0.0, 1.0, (11, FLOATERS), generators, view.image)
    number = uniform(1.0, FLOATERS + 1.0, (1,), generators, view.image).floor()
    present = torch.arange(FLOATERS, device=view.image.device) < number
    centre = chance[:, 0:2].mT * size
    # A side ratio of at most 2.5: what is thinner is a needle.
    sigma = (side * (0.03 + 0.09 * chance[:, 2]))[..., None] * torch.stack(
        [torch.ones_like(chance[:, 3]), 0.4 + 0.6 * chance[:, 3]], dim=2
    )
    borrowed = colour_at(view, chance[:, 4:6].mT * size)
    kind, tone = chance[:, 6, :, None], chance[:, 7, :, None]
    colour = torch.where(kind < 0.8, borrowed, torch.where(kind < 0.9, 0.15 * tone, 0.8 + 0.2 * tone))
    opacity = strength[:, None] * present * (0.15 + 0.75 * chance[:, 8].square())
    depth = depth_level(view) * (0.1 + 0.3 * chance[:, 9])
    return composite(view, SplatLayer(centre, sigma.log(), math.pi * chance[:, 10], opacity, colour, depth))
