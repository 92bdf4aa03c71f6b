"""Colour distortion, as saving in another colour space causes it.

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
"""Distance of the palette's levels at strength 1: sixteen levels a channel."""

LUMA_STEP, CHROMA_STEP = 1 / 64, 1 / 24
TONE = 0.05
"""Largest deviation from 1 of a channel's gamma and gain at strength 1."""

DARKEST = 1e-6


def quantise(values: Float[Tensor, "b c h w"], step: Float[Tensor, "#b #c 1 1"]) -> Float[Tensor, "b c h w"]:
    """The nearest multiples of a step; to the gradient, the values themselves (straight-through).

    Args:
        values: of any range.
        step: >= 0; 0 leaves the values as they are.
    """
    multiple = (values / torch.where(step > 0, step, torch.ones_like(step))).round() * step
    return values + torch.where(step > 0, multiple - values, torch.zeros_like(values)).detach()


def palette(image: Float[Tensor, "b 3 h w"], strength: Float[Tensor, " b"]) -> Float[Tensor, "b 3 h w"]:
    """Few levels in each channel: down to sixteen at strength 1."""
    return quantise(image, PALETTE_STEP * per_sample(strength))


def coarse_ycbcr(image: Float[Tensor, "b 3 h w"], strength: Float[Tensor, " b"]) -> Float[Tensor, "b 3 h w"]:
    """Few levels of luma and fewer of chroma (BT.601, full range): steps of 1/64 and 1/24 at strength 1."""
    step = image.new_tensor([LUMA_STEP, CHROMA_STEP, CHROMA_STEP])[:, None, None]
    # Chroma's levels lie about its zero, so that grey stays grey.
    zero = image.new_tensor([0.0, 0.5, 0.5])[:, None, None]
    return ycbcr_to_rgb(quantise(rgb_to_ycbcr(image) - zero, step * per_sample(strength)) + zero)


def change_tone(
    image: Float[Tensor, "b 3 h w"], strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]
) -> Float[Tensor, "b 3 h w"]:
    """A gamma and a gain for each channel, (1 + g) x^(1 + h), with g and h uniform within 0.05 strength.

    The gammas are those of NeRFLiX (Zhou et al., CVPR 2023), here on [0, 1].
    """
    gamma, gain = (
        1 + TONE * per_sample(strength)[:, None] * uniform(-1.0, 1.0, (2, 3, 1, 1), generators, image)
    ).unbind(1)
    return gain * image.clamp_min(DARKEST) ** gamma


def colour(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Distort colours in one of three ways: `palette`, `coarse_ycbcr` or `change_tone`, clamped to [0, 1].

    Rounding has the straight-through gradient.

    Args:
        view: what is degraded; depth and opacity stay.
        strength: of each sample, [0, 1].
        generators: one for each sample.
    """
    image = view.image
    ways = torch.stack(
        [palette(image, strength), coarse_ycbcr(image, strength), change_tone(image, strength, generators)]
    )
    direction = torch.tensor(whole_numbers(0, 2, generators), device=image.device)
    distorted = ways[direction, torch.arange(len(view), device=image.device)].clamp(0, 1)
    return replace(view, image=torch.where(per_sample(strength) > 0, distorted, image))
