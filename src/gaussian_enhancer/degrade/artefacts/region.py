"""Soft oriented regions, which limit artefacts to a part of the image.

Axes: b batch, h height, w width.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.fields import oriented_gaussian
from gaussian_enhancer.degrade.artefacts.rng import uniform
from gaussian_enhancer.degrade.artefacts.view import View


def soft_region(
    height: int, width: int, generators: Sequence[torch.Generator], like: Tensor
) -> Float[Tensor, "b 1 h w"]:
    """Mask of an artefact: the union of two anisotropic Gaussians at random places and angles, 1 at their centres.

    As the masks of NeRFLiX (Zhou et al., CVPR 2023), but with sizes relative to the image: standard deviations are 0.1
    to 0.5 of its larger side.

    Args:
        height: in pixels.
        width: in pixels.
        generators: one for each sample.
        like: a tensor with the dtype and device of the result.
    """
    centre_x, centre_y, angle, along, across = uniform(0.0, 1.0, (5, 2, 1, 1), generators, like).unbind(1)
    side = max(height, width)
    y = (torch.arange(height, device=like.device, dtype=like.dtype) + 0.5)[:, None]
    x = (torch.arange(width, device=like.device, dtype=like.dtype) + 0.5)[None, :]
    right, down = x - centre_x * width, y - centre_y * height
    deviations = side * (0.1 + 0.4 * along), side * (0.1 + 0.4 * across)
    bumps = oriented_gaussian(right, down, *deviations, math.pi * angle)
    return 1 - (1 - bumps).prod(dim=1, keepdim=True)


def blend_in_region(view: View, degraded: View, region: Float[Tensor, "b 1 h w"]) -> View:
    """Blend the degraded view inside a soft region with the original view outside.

    Args:
        view: the original view.
        degraded: the degraded view.
        region: weight of the degraded view at each pixel, [0, 1].
    """
    image = view.image + region * (degraded.image - view.image)
    alpha = view.alpha
    if view.alpha is not None and degraded.alpha is not None:
        alpha = view.alpha + region * (degraded.alpha - view.alpha)
    depth = view.depth
    if view.depth is not None and degraded.depth is not None:
        # If one of the views has no depth at a pixel, depths cannot be mixed: take that of the larger weight.
        both_known = (view.depth > 0) & (degraded.depth > 0)
        mixed = torch.lerp(view.depth, degraded.depth, region)  # exact at both ends, whatever the depths
        depth = torch.where(both_known, mixed, torch.where(region > 0.5, degraded.depth, view.depth))
    return View(image, depth, alpha)
