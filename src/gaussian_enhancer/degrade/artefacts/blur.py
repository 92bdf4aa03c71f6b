"""Blur: several Gaussian kernels with smoothly varying mixture weights over the image.

Axes: b batch, n kernels, h height, w width, k side of a kernel.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from kornia.filters import filter2d
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.fields import oriented_gaussian, smooth_field
from gaussian_enhancer.degrade.artefacts.rng import uniform
from gaussian_enhancer.degrade.artefacts.view import View

MAX_SIGMA = 2.5
"""Largest standard deviation along the long axis at strength 1, in pixels."""

MIN_SIGMA = 0.02
KERNELS = 3
CELL = 8
CONTRAST = 3.0


def oriented_kernels(
    along: Float[Tensor, "b n"], across: Float[Tensor, "b n"], angle: Float[Tensor, "b n"]
) -> Float[Tensor, "b n k k"]:
    """Oriented Gaussian kernels that sum to 1; with standard deviations below 0.02 pixels they are unit impulses.

    Args:
        along: standard deviation along the axis, in pixels, at most `MAX_SIGMA`.
        across: standard deviation perpendicular to it, in pixels.
        angle: angle between the axis and x, in radians.
    """
    radius = math.ceil(2.8 * MAX_SIGMA)
    offset = torch.arange(-radius, radius + 1, device=along.device, dtype=along.dtype)
    down, right = torch.meshgrid(offset, offset, indexing="ij")
    along, across, angle = (value[..., None, None] for value in (along, across, angle))
    kernels = oriented_gaussian(right, down, along.clamp_min(MIN_SIGMA), across.clamp_min(MIN_SIGMA), angle)
    return kernels / kernels.sum(dim=(-2, -1), keepdim=True)


def blur(view: View, strength: Float[Tensor, " b"], generators: Sequence[torch.Generator]) -> View:
    """Blur by one isotropic and two anisotropic Gaussian kernels, mixed at each pixel: x + sum_n a_n (k_n - 1) * x.

    As the `multiple_blur` of NeRFLiX (Zhou et al., CVPR 2023), with weights a that are the softmax of smooth random
    maps. Here the kernels' variances are proportional to the strength, so that the change of the image is, too, for
    small strengths. Standard deviations along the long axis reach 1 to 2.5 pixels at strength 1. The impulse is
    subtracted from each kernel before the convolution, so that strength 0 changes nothing on any device.

    Depth and opacity stay unchanged.
    """
    image = view.image
    batch, _, height, width = image.shape
    size, ratio, orientation = uniform(0.0, 1.0, (3, KERNELS), generators, image).unbind(1)
    isotropic = torch.arange(KERNELS, device=image.device) == 0
    along = strength[:, None].sqrt() * MAX_SIGMA * (0.4 + 0.6 * size)
    kernels = oriented_kernels(along, along * torch.where(isotropic, 1.0, 0.2 + 0.6 * ratio), math.pi * orientation)
    middle = kernels.shape[-1] // 2
    kernels[..., middle, middle] -= 1
    weights = torch.softmax(CONTRAST * smooth_field(KERNELS, CELL, height, width, generators, image), dim=1)
    changes = filter2d(image.repeat_interleave(KERNELS, dim=0), kernels.flatten(0, 1), border_type="replicate")
    changes = changes.unflatten(0, (batch, KERNELS))
    return replace(view, image=image + (weights[:, :, None] * changes).sum(dim=1))
