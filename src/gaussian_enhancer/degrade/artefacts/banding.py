"""Banding: rows of large flat disks that stand in for far surfaces and show their rims.

Axes: b batch, k splats.
"""

import dataclasses
import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import uniform
from gaussian_enhancer.degrade.artefacts.splats import SplatLayer, colour_covered, composite, depth_level
from gaussian_enhancer.degrade.artefacts.view import View

BANDS = 12
"""Disks of a sample; those that fall outside the image are not seen."""


def banding(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Visible bands, as 2DGS shows in unbounded scenes: parallel long disks with flat tones, overlapping a little.

    Each band has the mean colour of what it covers, made 3 to 10% brighter or darker in turn, which leaves steps of 2
    to 6% where the band is half transparent. The bands lie at almost one depth, a tenth in front of the depth below
    which 60% of the view lies: what is nearer stays free of them. Opacity grows with strength.

    Args:
        view: what is degraded.
        strength: of each sample, [0, 1].
        generators: one for each sample.
    """
    height, width = view.image.shape[-2:]
    side = math.sqrt(height * width)
    chance = uniform(0.0, 1.0, (6, BANDS), generators, view.image)
    place, turn, thick, far, first = uniform(0.0, 1.0, (5, 1), generators, view.image).unbind(1)
    step = torch.arange(BANDS, device=view.image.device, dtype=view.image.dtype) - (BANDS - 1) / 2

    # Horizons are level: bands lean little, and slide along themselves.
    lean = 0.35 * (2 * turn - 1)
    across = side * (0.02 + 0.04 * thick)
    along = side * (0.25 + 0.45 * chance[:, 0])
    shift, slide = 1.6 * across * (step + 0.4 * (chance[:, 1] - 0.5)), side * (chance[:, 2] - 0.5)
    centre_x = width / 2 + slide * lean.cos() - shift * lean.sin()
    centre_y = height * place + slide * lean.sin() + shift * lean.cos()
    sigma = torch.stack([along, across * (0.8 + 0.4 * chance[:, 3])], dim=2)

    share = 0.35 + 0.3 * chance[:, 4]
    depth = depth_level(view, 0.6) * 0.9 * (1 + 0.05 * (far - 0.5) + 0.002 * step)
    disks = SplatLayer(
        torch.stack([centre_x, centre_y], dim=2),
        sigma.clamp_min(0.5).log(),
        lean.expand(-1, BANDS),
        strength[:, None] * share,
        sigma.new_zeros(len(view), BANDS, 3),
        depth,
    )
    sign = torch.where((torch.arange(BANDS, device=step.device) % 2 == 0) ^ (first < 0.5), 1.0, -1.0)
    tone = 1 + sign * (0.03 + 0.07 * chance[:, 5])
    colour = (colour_covered(view, disks, "disk") * tone[..., None]).clamp(0, 1)
    return composite(view, dataclasses.replace(disks, colour=colour), "disk")
