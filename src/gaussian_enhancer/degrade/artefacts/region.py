"""Artefacts that act on a part of the image: soft oriented regions.

Axes: b batch, h height, w width.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.rng import uniform
from gaussian_enhancer.degrade.artefacts.view import View


def soft_region(
    height: int, width: int, generators: Sequence[torch.Generator], like: Tensor
) -> Float[Tensor, "b 1 h w"]:
    """Where an artefact acts: the union of two oriented anisotropic Gaussians, 1 at their centres.

    As the masks of NeRFLiX (Zhou et al., CVPR 2023), with sizes relative to the image: standard deviations of 0.1 to
    0.5 of its larger side, at random places and angles.

    Args:
        height: in pixels.
        width: in pixels.
        generators: one for each sample.
        like: a tensor whose type and device the result has.
    """
    centre_x, centre_y, angle, along, across = uniform(0.0, 1.0, (5, 2, 1, 1), generators, like).unbind(1)
    side = max(height, width)
    y = (torch.arange(height, device=like.device, dtype=like.dtype) + 0.5)[:, None]
    x = (torch.arange(width, device=like.device, dtype=like.dtype) + 0.5)[None, :]
    right, down = x - centre_x * width, y - centre_y * height
    cosine, sine = torch.cos(math.pi * angle), torch.sin(math.pi * angle)
    first = (cosine * right + sine * down) / (side * (0.1 + 0.4 * along))
    second = (cosine * down - sine * right) / (side * (0.1 + 0.4 * across))
    bumps = torch.exp(-0.5 * (first.square() + second.square()))
    return 1 - (1 - bumps).prod(dim=1, keepdim=True)


def blend_in_region(view: View, degraded: View, region: Float[Tensor, "b 1 h w"]) -> View:
    """The degraded view inside a region and the untouched one outside, softly.

    Args:
        view: before.
        degraded: after.
        region: share of the degraded view at each pixel, [0, 1].
    """
    image = view.image + region * (degraded.image - view.image)
    alpha = view.alpha
    if view.alpha is not None and degraded.alpha is not None:
        alpha = view.alpha + region * (degraded.alpha - view.alpha)
    depth = view.depth
    if view.depth is not None and degraded.depth is not None:
        # Where either is empty there is no depth between the two: take the nearer share's.
        both = (view.depth > 0) & (degraded.depth > 0)
        mixed = view.depth + region * (degraded.depth - view.depth)
        depth = torch.where(both, mixed, torch.where(region > 0.5, degraded.depth, view.depth))
    return View(image, depth, alpha)
