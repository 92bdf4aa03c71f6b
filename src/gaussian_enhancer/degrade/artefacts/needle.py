"""Needles: thin splats that an under-constrained fit leaves along edges and over plain surfaces.

Axes: b batch, k splats.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import normal, uniform
from gaussian_enhancer.degrade.artefacts.splats import SplatLayer, colour_at, composite, depth_at
from gaussian_enhancer.degrade.artefacts.view import View

AREA = 220
"""Pixels to one needle, up to `MOST` of them; in larger images needles grow with the image instead."""

MOST = 160
"""Needles in an image, at most."""

CROWDED = 0.8
"""Share of the needles that crowd around one place."""

LENGTHS = 0.014, 0.1
"""Standard deviations along needles, of the image's side sqrt(h w)."""

RATIOS = 5.0, 50.0
"""Length over thickness."""

THINNEST = 0.55
"""Standard deviation in pixels below which no rasteriser draws: its low-pass filter adds a variance of 0.3."""


def needle(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Strongly anisotropic splats, coloured from where they lie or, when misplaced, from nearby, a little off in tone.

    Most of a sample's needles crowd around one place, in two directions that cross, as they do about thin structure and
    in the background that few cameras saw: there they hide what lies behind. The others are scattered. Each lies 1 to
    12% in front of the surface at its centre. Opacity grows with strength. Numbers, sizes and tones were set beside
    worst crops of training fits (`gaussian-enhancer artefact_sheet`).

    Args:
        view: what is degraded.
        strength: of each sample, [0, 1].
        generators: one for each sample.
    """
    height, width = view.image.shape[-2:]
    count, side = min(max(height * width // AREA, 1), MOST), math.sqrt(height * width)
    chance = uniform(0.0, 1.0, (11, count), generators, view.image)
    spread = normal((8, count), generators, view.image)
    crowd = uniform(0.0, 1.0, (6, 1), generators, view.image)
    crowded = chance[:, 0] < CROWDED
    size = view.image.new_tensor([width, height])

    near = crowd[:, 1:3].mT + (0.06 + 0.12 * crowd[:, 4, :, None]) * spread[:, 0:2].mT
    centre = torch.where(crowded[..., None], near, chance[:, 1:3].mT) * size
    crossing = (chance[:, 10] < 0.4) * (0.2 + 0.6 * crowd[:, 5])
    angle = math.pi * torch.where(crowded, crowd[:, 0] + crossing + 0.06 * spread[:, 2], chance[:, 3])
    length = side * LENGTHS[0] * (LENGTHS[1] / LENGTHS[0]) ** chance[:, 4]
    ratio = RATIOS[0] * (RATIOS[1] / RATIOS[0]) ** chance[:, 5]
    sigma = torch.stack([length.clamp_min(THINNEST), (length / ratio).clamp_min(THINNEST)], dim=2)

    misplaced = (chance[:, 6] < 0.5)[..., None]
    source = centre + misplaced * (0.1 * side) * spread[:, 3:5].mT
    # Splats that stand out did not find their colour: they are well off in brightness, a little in hue.
    tone = 0.35 * spread[:, 5, :, None] + 0.05 * spread[:, 5:8].mT
    colour = (colour_at(view, source) * (1 + tone) + 0.1 * tone).clamp(0, 1)
    present = chance[:, 7] < 0.4 + 0.6 * crowd[:, 3]
    opacity = strength[:, None] * present * (0.5 + 0.45 * chance[:, 8])
    depth = depth_at(view, centre) * (0.88 + 0.11 * chance[:, 9])
    return composite(view, SplatLayer(centre, sigma.log(), angle, opacity, colour, depth))
