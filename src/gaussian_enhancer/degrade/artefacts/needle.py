"""Needles: thin splats that an under-constrained fit leaves along edges and over uniform surfaces.

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
"""Pixels per needle. The number is limited to `MAX_NEEDLES`; in larger images, needles are larger instead."""

MAX_NEEDLES = 160
"""Largest number of needles per sample."""

CLUSTER_SHARE = 0.8
"""Share of the needles in a cluster around one place."""

LENGTHS = 0.014, 0.1
"""Smallest and largest standard deviation along needles, relative to the image's side sqrt(h w)."""

RATIOS = 5.0, 50.0
"""Smallest and largest ratio of length to thickness."""

MIN_SIGMA = 0.55
"""Smallest standard deviation that rasterisers draw, in pixels: their low-pass filter adds a variance of 0.3."""


def needle(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Draw strongly anisotropic splats with the image's colour at their centre or, if misplaced, from nearby.

    Their tone deviates from this colour. Most needles of a sample form a cluster around one place, in two crossing
    directions, as around thin structures and in background that few cameras saw. There they hide what lies behind. The
    others are scattered. Each needle lies 1 to 12% in front of the surface at its centre. Opacity is proportional to
    strength. Numbers, sizes and tones were set by comparison with the worst crops of training fits
    (`gaussian-enhancer artefact_sheet`).
    """
    height, width = view.image.shape[-2:]
    count, side = min(max(height * width // AREA, 1), MAX_NEEDLES), math.sqrt(height * width)
    random = uniform(0.0, 1.0, (11, count), generators, view.image)
    deviation = normal((8, count), generators, view.image)
    cluster = uniform(0.0, 1.0, (6, 1), generators, view.image)
    in_cluster = random[:, 0] < CLUSTER_SHARE
    size = view.image.new_tensor([width, height])

    cluster_centre = cluster[:, 1:3].mT + (0.06 + 0.12 * cluster[:, 4, :, None]) * deviation[:, 0:2].mT
    centre = torch.where(in_cluster[..., None], cluster_centre, random[:, 1:3].mT) * size
    crossing = (random[:, 10] < 0.4) * (0.2 + 0.6 * cluster[:, 5])
    angle = math.pi * torch.where(in_cluster, cluster[:, 0] + crossing + 0.06 * deviation[:, 2], random[:, 3])
    length = side * LENGTHS[0] * (LENGTHS[1] / LENGTHS[0]) ** random[:, 4]
    ratio = RATIOS[0] * (RATIOS[1] / RATIOS[0]) ** random[:, 5]
    sigma = torch.stack([length.clamp_min(MIN_SIGMA), (length / ratio).clamp_min(MIN_SIGMA)], dim=2)

    misplaced = (random[:, 6] < 0.5)[..., None]
    source = centre + misplaced * (0.1 * side) * deviation[:, 3:5].mT
    # Needles that stand out have not converged to their colour: they differ much in brightness, little in hue.
    tone = 0.35 * deviation[:, 5, :, None] + 0.05 * deviation[:, 5:8].mT
    colour = (colour_at(view, source) * (1 + tone) + 0.1 * tone).clamp(0, 1)
    present = random[:, 7] < 0.4 + 0.6 * cluster[:, 3]
    opacity = strength[:, None] * present * (0.5 + 0.45 * random[:, 8])
    depth = depth_at(view, centre) * (0.88 + 0.11 * random[:, 9])
    return composite(view, SplatLayer(centre, sigma.log(), angle, opacity, colour, depth))
