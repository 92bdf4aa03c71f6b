"""Colour distortion: quantised palettes, quantised YCbCr, or changed gamma and gain.

Axes: b batch, h height, w width.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from kornia.color import rgb_to_ycbcr, ycbcr_to_rgb
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import uniform, whole_numbers
from gaussian_enhancer.degrade.artefacts.view import View, per_sample

PALETTE_STEP = 1 / 15
"""Distance between the palette's levels at strength 1: sixteen levels per channel."""

LUMA_STEP, CHROMA_STEP = 1 / 64, 1 / 24
TONE = 0.05
"""Largest deviation of a channel's gamma and gain from 1, at strength 1."""

DARKEST = 1e-6


def quantise(values: Float[Tensor, "b c h w"], step: Float[Tensor, "#b #c 1 1"]) -> Float[Tensor, "b c h w"]:
    """Round to the nearest multiples of a step, with the straight-through gradient.

    Args:
        values: values of any range.
        step: step >= 0; 0 leaves the values unchanged.
    """
    multiple = (values / torch.where(step > 0, step, torch.ones_like(step))).round() * step
    return values + torch.where(step > 0, multiple - values, torch.zeros_like(values)).detach()


def palette(image: Float[Tensor, "b 3 h w"], strength: Float[Tensor, " b"]) -> Float[Tensor, "b 3 h w"]:
    """Quantise each channel, to sixteen levels at strength 1."""
    return quantise(image, PALETTE_STEP * per_sample(strength))


def coarse_ycbcr(image: Float[Tensor, "b 3 h w"], strength: Float[Tensor, " b"]) -> Float[Tensor, "b 3 h w"]:
    """Quantise luma and, more coarsely, chroma (BT.601, full range), by steps of 1/64 and 1/24 at strength 1."""
    step = image.new_tensor([LUMA_STEP, CHROMA_STEP, CHROMA_STEP])[:, None, None]
    # The levels of chroma include its zero, so that grey stays grey.
    origin = image.new_tensor([0.0, 0.5, 0.5])[:, None, None]
    return ycbcr_to_rgb(quantise(rgb_to_ycbcr(image) - origin, step * per_sample(strength)) + origin)


def change_tone(
    image: Float[Tensor, "b 3 h w"], strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]
) -> Float[Tensor, "b 3 h w"]:
    """Apply a gamma and a gain to each channel: (1 + g) x^(1 + h), with g and h uniform in +-0.05 strength.

    The gammas are those of NeRFLiX (Zhou et al., CVPR 2023), here on [0, 1].
    """
    gamma, gain = (
        1 + TONE * per_sample(strength)[:, None] * uniform(-1.0, 1.0, (2, 3, 1, 1), generators, image)
    ).unbind(1)
    return gain * image.clamp_min(DARKEST) ** gamma


def colour(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Distort colours in one of three ways: `palette`, `coarse_ycbcr` or `change_tone`, clamped to [0, 1].

    Rounding has the straight-through gradient.

    Depth and opacity stay unchanged.
    """
    image = view.image
    variants = torch.stack(
        [palette(image, strength), coarse_ycbcr(image, strength), change_tone(image, strength, generators)]
    )
    choice = torch.tensor(whole_numbers(0, 2, generators), device=image.device)
    distorted = variants[choice, torch.arange(len(view), device=image.device)].clamp(0, 1)
    return replace(view, image=torch.where(per_sample(strength) > 0, distorted, image))
