"""Banding: rows of flat disks that represent distant surfaces, with visible edges.

Axes: b batch, k splats.
"""

import dataclasses
import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import uniform
from gaussian_enhancer.degrade.artefacts.splats import SplatLayer, composite, covered_colour, depth_quantile
from gaussian_enhancer.degrade.artefacts.view import View

ROWS, DISKS = 12, 5
"""Rows per sample, and disks per row; some may lie outside the image."""


def banding(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Draw visible bands, as 2DGS has them in unbounded scenes: parallel, slightly overlapping rows of long flat disks.

    Each disk has the mean colour of the pixels that it covers, brightened or darkened by 4 to 18%, alternating by row.
    It hides most of what it covers: the texture of the distant surface is lost and the disks' edges are visible. All
    disks lie at nearly the same depth, 10% in front of the 60% quantile of the view's depth, so that nearer surfaces
    are not covered. Opacity is proportional to strength. Sizes and tones were set by comparison with the worst crops of
    training fits (`gaussian-enhancer artefact_sheet`).
    """
    height, width = view.image.shape[-2:]
    side = math.sqrt(height * width)
    random = uniform(0.0, 1.0, (6, ROWS * DISKS), generators, view.image)
    position, tilt, thickness, distance, first_tone = uniform(0.0, 1.0, (5, 1), generators, view.image).unbind(1)
    row = torch.arange(ROWS, device=view.image.device).repeat_interleave(DISKS)
    step = row.to(view.image) - (ROWS - 1) / 2

    # Horizons are level: bands are nearly horizontal. The disks are shifted at random along their row.
    angle = 0.35 * (2 * tilt - 1)
    across = side * (0.012 + 0.028 * thickness)
    along = side * (0.1 + 0.22 * random[:, 0])
    shift, slide = 1.5 * across * (step + 0.5 * (random[:, 1] - 0.5)), 1.3 * side * (random[:, 2] - 0.5)
    centre_x = width / 2 + slide * angle.cos() - shift * angle.sin()
    centre_y = height * position + slide * angle.sin() + shift * angle.cos()
    sigma = torch.stack([along, across * (0.7 + 0.6 * random[:, 3])], dim=2)

    opacity = 0.6 + 0.35 * random[:, 4]
    depth = depth_quantile(view, 0.6) * 0.9 * (1 + 0.05 * (distance - 0.5) + 0.002 * step)
    disks = SplatLayer(
        torch.stack([centre_x, centre_y], dim=2),
        sigma.clamp_min(0.5).log(),
        angle.expand(-1, ROWS * DISKS),
        strength[:, None] * opacity,
        sigma.new_zeros(len(view), ROWS * DISKS, 3),
        depth,
    )
    sign = torch.where((row % 2 == 0) ^ (first_tone < 0.5), 1.0, -1.0)
    tone = 1 + sign * (0.04 + 0.14 * random[:, 5])
    colour = (covered_colour(view, disks, "disk") * tone[..., None]).clamp(0, 1)
    return composite(view, dataclasses.replace(disks, colour=colour), "disk")
