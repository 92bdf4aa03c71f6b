"""Cloudy: veils of a few very large, transparent splats in empty space.

Axes: b batch, k splats.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import uniform
from gaussian_enhancer.degrade.artefacts.splats import SplatLayer, composite, depth_quantile
from gaussian_enhancer.degrade.artefacts.view import View

VEILS = 5
"""Largest number of veils per sample; the smallest is 2."""


def cloudy(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Draw low-frequency veils with colours between grey and the image's mean, at 20 to 70% of the median depth.

    Standard deviations are 20 to 60% of the image's side sqrt(h w). A veil's opacity is proportional to the strength,
    and at most 0.4.
    """
    height, width = view.image.shape[-2:]
    random = uniform(0.0, 1.0, (9, VEILS), generators, view.image)
    count = uniform(2.0, VEILS + 1.0, (1,), generators, view.image).floor()
    present = torch.arange(VEILS, device=view.image.device) < count
    centre = (1.4 * random[:, 0:2].mT - 0.2) * view.image.new_tensor([width, height])
    sigma = math.sqrt(height * width) * (0.2 + 0.4 * random[:, 2:4].mT)
    mean = view.image.mean(dim=(2, 3))[:, None]
    grey = (0.35 + 0.5 * random[:, 4])[..., None]
    colour = mean + (0.3 + 0.7 * random[:, 5])[..., None] * (grey - mean)
    opacity = strength[:, None] * present * (0.12 + 0.28 * random[:, 6])
    depth = depth_quantile(view) * (0.2 + 0.5 * random[:, 7])
    return composite(view, SplatLayer(centre, sigma.log(), math.pi * random[:, 8], opacity, colour.clamp(0, 1), depth))
