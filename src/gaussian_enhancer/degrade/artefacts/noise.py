"""Splatted noise: coloured and slightly blurred, within oriented regions.

Axes: b batch, h height, w width.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from kornia.filters import filter2d_separable, get_gaussian_kernel1d
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.region import soft_region
from gaussian_enhancer.degrade.artefacts.rng import normal, uniform
from gaussian_enhancer.degrade.artefacts.view import View, per_sample

MAX_SIGMA = 0.05
"""Standard deviation at strength 1, where the region is 1."""

BLUR_SIGMA = 1.0


def smooth_noise(white: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
    """Smooth white noise by a Gaussian with a standard deviation of one pixel, and restore its variance."""
    kernel = get_gaussian_kernel1d(7, BLUR_SIGMA, device=white.device, dtype=white.dtype)
    return filter2d_separable(white, kernel, kernel, border_type="replicate") / kernel.square().sum()


def noise(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Add Gaussian noise in a soft oriented region m: clamp(x + strength 0.05 m (cos(t) white + sin(t) blurred)).

    After NeRFLiX (Zhou et al., CVPR 2023), whose noise is white. Splats have an extent, so here a random share of the
    noise's variance, sin(t)^2, is correlated over one or two pixels.

    Depth and opacity stay unchanged.
    """
    image = view.image
    height, width = image.shape[-2:]
    region = soft_region(height, width, generators, image)
    mixing_angle = uniform(0.0, torch.pi / 2, (1, 1, 1), generators, image)
    white, unblurred = normal((2, 3, height, width), generators, image).unbind(1)
    noise_field = torch.cos(mixing_angle) * white + torch.sin(mixing_angle) * smooth_noise(unblurred)
    return replace(view, image=(image + MAX_SIGMA * per_sample(strength) * region * noise_field).clamp(0, 1))
