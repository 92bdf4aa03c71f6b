"""Cloudy: veils of few, very large, thin splats that hang in empty space.

Axes: b batch, k splats.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import uniform
from gaussian_enhancer.degrade.artefacts.splats import SplatLayer, composite, depth_level
from gaussian_enhancer.degrade.artefacts.view import View

VEILS = 5
"""Splats of a sample at most; two are always there."""


def cloudy(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Low-frequency veils between grey and the image's mean colour, from near to the middle of the scene.

    Standard deviations are 20 to 60% of the image's side; opacity is at most 0.4 a veil and grows with strength.

    Args:
        view: what is degraded.
        strength: of each sample, [0, 1].
        generators: one for each sample.
    """
    height, width = view.image.shape[-2:]
    chance = uniform(0.0, 1.0, (9, VEILS), generators, view.image)
    number = uniform(2.0, VEILS + 1.0, (1,), generators, view.image).floor()
    present = torch.arange(VEILS, device=view.image.device) < number
    centre = (1.4 * chance[:, 0:2].mT - 0.2) * view.image.new_tensor([width, height])
    sigma = math.sqrt(height * width) * (0.2 + 0.4 * chance[:, 2:4].mT)
    mean = view.image.mean(dim=(2, 3))[:, None]
    grey = (0.35 + 0.5 * chance[:, 4])[..., None]
    colour = mean + (0.3 + 0.7 * chance[:, 5])[..., None] * (grey - mean)
    opacity = strength[:, None] * present * (0.12 + 0.28 * chance[:, 6])
    depth = depth_level(view) * (0.2 + 0.5 * chance[:, 7])
    return composite(view, SplatLayer(centre, sigma.log(), math.pi * chance[:, 8], opacity, colour.clamp(0, 1), depth))
