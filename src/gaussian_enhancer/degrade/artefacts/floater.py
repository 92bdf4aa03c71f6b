"""Floaters: compact blobs near the camera, where the training views do not constrain the fit.

Axes: b batch, k splats.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import uniform
from gaussian_enhancer.degrade.artefacts.splats import SplatLayer, colour_at, composite, depth_quantile
from gaussian_enhancer.degrade.artefacts.view import View

FLOATERS = 6
"""Largest number of blobs per sample; the smallest is 1."""


def floater(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Draw soft blobs at 10 to 40% of the median depth, coloured like a random pixel of the image, dark, or bright.

    Standard deviations along the long axis are 3 to 12% of the image's side sqrt(h w). Opacity is proportional to the
    strength. At strength 1 it is 0.15 to 0.9, and rarely large, since a fit removes blobs that are opaque in a training
    view.
    """
    height, width = view.image.shape[-2:]
    size, side = view.image.new_tensor([width, height]), math.sqrt(height * width)
    random = uniform(0.0, 1.0, (11, FLOATERS), generators, view.image)
    count = uniform(1.0, FLOATERS + 1.0, (1,), generators, view.image).floor()
    present = torch.arange(FLOATERS, device=view.image.device) < count
    centre = random[:, 0:2].mT * size
    # The ratio of the axes is at most 2.5: thinner splats would be needles.
    sigma = (side * (0.03 + 0.09 * random[:, 2]))[..., None] * torch.stack(
        [torch.ones_like(random[:, 3]), 0.4 + 0.6 * random[:, 3]], dim=2
    )
    image_colour = colour_at(view, random[:, 4:6].mT * size)
    kind, tone = random[:, 6, :, None], random[:, 7, :, None]
    colour = torch.where(kind < 0.8, image_colour, torch.where(kind < 0.9, 0.15 * tone, 0.8 + 0.2 * tone))
    opacity = strength[:, None] * present * (0.15 + 0.75 * random[:, 8].square())
    depth = depth_quantile(view) * (0.1 + 0.3 * random[:, 9])
    return composite(view, SplatLayer(centre, sigma.log(), math.pi * random[:, 10], opacity, colour, depth))
