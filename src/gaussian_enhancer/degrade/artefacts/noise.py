"""Noise of splatting: coloured, slightly blobby, within oriented regions.

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

LOUDEST = 0.05
"""Standard deviation at strength 1, where the region is 1."""

BLOB = 1.0


def smooth_noise(white: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
    """White noise smoothed by a Gaussian of one pixel's standard deviation, with the variance that it had."""
    kernel = get_gaussian_kernel1d(7, BLOB, device=white.device, dtype=white.dtype)
    return filter2d_separable(white, kernel, kernel, border_type="replicate") / kernel.square().sum()


def noise(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Splatted Gaussian noise: clamp(x + strength 0.05 m (cos(t) white + sin(t) blobby)) in a soft oriented region m.

    After NeRFLiX (Zhou et al., CVPR 2023). Theirs is white; splats have an extent, so here a random share of the
    noise, sin(t)^2, is correlated over a pixel or two.

    Args:
        view: what is degraded; depth and opacity stay.
        strength: of each sample, [0, 1].
        generators: one for each sample.
    """
    image = view.image
    height, width = image.shape[-2:]
    region = soft_region(height, width, generators, image)
    turn = uniform(0.0, torch.pi / 2, (1, 1, 1), generators, image)
    white, other = normal((2, 3, height, width), generators, image).unbind(1)
    noise_field = torch.cos(turn) * white + torch.sin(turn) * smooth_noise(other)
    return replace(view, image=(image + LOUDEST * per_sample(strength) * region * noise_field).clamp(0, 1))
