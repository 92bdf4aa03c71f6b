"""Banding: rows of flat disks that stand in for far surfaces and show their rims.

Axes: b batch, k splats.
"""

import dataclasses
import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import uniform
from gaussian_enhancer.degrade.artefacts.splats import SplatLayer, composite, covered_colour, depth_level
from gaussian_enhancer.degrade.artefacts.view import View

ROWS, DISKS = 12, 5
"""Rows of a sample and disks in each; those that fall outside the image are not seen."""


def banding(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Visible bands, as 2DGS shows in unbounded scenes: parallel rows of long flat disks, overlapping a little.

    Each disk has the mean colour of what it covers, made 4 to 18% brighter or darker, row by row in turn, and hides
    most of it: the far surface's texture is lost and the rims show. The disks lie at almost one depth, a tenth in front
    of the depth below which 60% of the view lies: what is nearer stays free of them. Opacity grows with strength. Sizes
    and tones were set beside worst crops of training fits (`gaussian-enhancer artefact_sheet`).

    Args:
        view: what is degraded.
        strength: of each sample, [0, 1].
        generators: one for each sample.
    """
    height, width = view.image.shape[-2:]
    side = math.sqrt(height * width)
    chance = uniform(0.0, 1.0, (6, ROWS * DISKS), generators, view.image)
    position, turn, thick, far, first = uniform(0.0, 1.0, (5, 1), generators, view.image).unbind(1)
    row = torch.arange(ROWS, device=view.image.device).repeat_interleave(DISKS)
    step = row.to(view.image) - (ROWS - 1) / 2

    # Horizons are level: bands lean little, and slide along themselves.
    lean = 0.35 * (2 * turn - 1)
    across = side * (0.012 + 0.028 * thick)
    along = side * (0.1 + 0.22 * chance[:, 0])
    shift, slide = 1.5 * across * (step + 0.5 * (chance[:, 1] - 0.5)), 1.3 * side * (chance[:, 2] - 0.5)
    centre_x = width / 2 + slide * lean.cos() - shift * lean.sin()
    centre_y = height * position + slide * lean.sin() + shift * lean.cos()
    sigma = torch.stack([along, across * (0.7 + 0.6 * chance[:, 3])], dim=2)

    share = 0.6 + 0.35 * chance[:, 4]
    depth = depth_level(view, 0.6) * 0.9 * (1 + 0.05 * (far - 0.5) + 0.002 * step)
    disks = SplatLayer(
        torch.stack([centre_x, centre_y], dim=2),
        sigma.clamp_min(0.5).log(),
        lean.expand(-1, ROWS * DISKS),
        strength[:, None] * share,
        sigma.new_zeros(len(view), ROWS * DISKS, 3),
        depth,
    )
    sign = torch.where((row % 2 == 0) ^ (first < 0.5), 1.0, -1.0)
    tone = 1 + sign * (0.04 + 0.14 * chance[:, 5])
    colour = (covered_colour(view, disks, "disk") * tone[..., None]).clamp(0, 1)
    return composite(view, dataclasses.replace(disks, colour=colour), "disk")
