"""JPEG compression.

Axes: b batch.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from kornia.enhance import jpeg_codec_differentiable
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.view import View, fade_in

BEST, WORST = 95.0, 20.0
"""JPEG quality near strength 0, and at strength 1."""


def jpeg(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Compress as JPEG of quality 95 - 75 strength with chroma subsampling; the change fades in up to strength 0.1.

    Rounding is kornia's differentiable polynomial approximation (after Shin & Song, 2017), which rounds a little less
    than a real codec. Nothing is random.

    Depth and opacity stay unchanged.
    """
    coded = jpeg_codec_differentiable(view.image, BEST + (WORST - BEST) * strength).clamp(0, 1)
    return fade_in(view, coded, strength)
