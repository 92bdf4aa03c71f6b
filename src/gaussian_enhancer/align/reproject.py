"""Backward warp of a photo into another camera through rendered depth.

Axes: h height, w width of the target; p height, q width of a reference.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float, UInt8
from torch import Tensor

from gaussian_enhancer.align.projection import (
    Interpolation,
    Landing,
    ReferenceProjection,
    depth_consistency,
    land,
    read_at,
    read_both,
)
from gaussian_enhancer.types import FARTHEST_DEPTH, Camera, usable_depth

FAINTEST = 1 / 255
FINER = 1.2
"""Pixels of a photo between two of the target from which on it is shrunk before it is read."""
SAMPLED = 2**12
"""Pixels by which it is judged how finely a photo is read."""


@dataclass(frozen=True)
class Warped:
    """A reference on the target's grid.

    Args:
        colour: the photo's colours, 0 where nothing is visible.
        visibility: how surely the reference shows the target's surface, in [0, 1].
        render: the splat's own render of the reference's view, warped alike; None where unknown.
    """

    colour: Float[Tensor, "3 h w"]
    visibility: Float[Tensor, "1 h w"]
    render: Float[Tensor, "3 h w"] | None = None


def fill_depth(depth: Float[Tensor, "1 h w"]) -> Float[Tensor, "1 h w"]:
    """Close the holes of a depth map: each takes the nearest scale's average of its valid neighbours.

    Push and pull over a pyramid (Gortler et al., SIGGRAPH 1996) on inverse depth, so that a hole at the border of
    near and far leans to neither by scale. A map without any valid depth becomes 1 everywhere.

    Args:
        depth: z in scene units; what is not `usable_depth` is a hole.
    """
    least, most = depth.aminmax()  # not a number where one value is none
    if bool((least > 0) & (most < torch.inf) & (most <= FARTHEST_DEPTH)):
        return depth
    valid = usable_depth(depth)
    inverse = torch.where(valid, 1.0 / torch.where(valid, depth, torch.ones_like(depth)), torch.zeros_like(depth))
    levels = [(inverse[None], valid[None].to(depth.dtype))]
    while max(levels[-1][0].shape[-2:]) > 1:
        value, weight = levels[-1]
        total = F.avg_pool2d(weight, 2, ceil_mode=True, count_include_pad=False)
        mean = F.avg_pool2d(value * weight, 2, ceil_mode=True, count_include_pad=False)
        covered = total > 0
        levels.append((torch.where(covered, mean / total.clamp_min(1e-12), mean), covered.to(depth.dtype)))
    filled = torch.where(levels[-1][1] > 0, levels[-1][0], torch.ones_like(levels[-1][0]))
    for value, weight in reversed(levels[:-1]):
        coarse = F.interpolate(filled, size=value.shape[-2:], mode="bilinear", align_corners=False)
        filled = torch.where(weight > 0, value, coarse)
    return torch.where(valid, depth, 1.0 / filled[0])


def reproject(
    target: Camera,
    depth: Float[Tensor, "1 h w"],
    reference: Camera,
    photo: Float[Tensor, "3 p q"] | UInt8[Tensor, "3 p q"],
    reference_depth: Float[Tensor, "1 _ _"] | None = None,
    alpha: Float[Tensor, "1 h w"] | None = None,
    tolerance: float = 0.05,
    rendered_depth: Float[Tensor, "1 h w"] | None = None,
    render: Float[Tensor, "3 _ _"] | None = None,
    interpolation: Interpolation = "bilinear",
    footprint: float | None = None,
) -> Warped:
    """Warp a photo backwards into the target view through the target's depth.

    visibility = inside the photo x in front of it x alpha x exp(-((z - z') / (tolerance z))^2 / 2), where z is the
    point's depth in the reference and z' the depth that the reference itself renders there. The photo is first shrunk
    with antialiasing where it is finer than the target.

    Args:
        target: camera of the grid to fill.
        depth: rendered z of the target, scene units; holes are filled from their neighbours for the warp.
        reference: camera of the photo; scaled to the photo's size where the two differ.
        photo: reference colours at any resolution, [0, 1]; those of 8 bits are warped as they are, [0, 255].
        reference_depth: rendered z of the reference at any resolution; None leaves occlusion unchecked.
        alpha: rendered opacity of the target; None counts holes of the depth as invisible.
        tolerance: relative depth difference of one standard deviation, > 0.
        rendered_depth: the target's depth before it was refined, which alone compares with what the reference
            renders; None means ``depth``.
        render: the splat's own render of the reference's view, at any resolution, to be warped alike.
        interpolation: how photo and render are read between their pixels.
        footprint: distance in the photo between pixels that are neighbours in the target; None measures it.
    """
    dtype = depth.dtype if depth.dtype in (torch.float32, torch.float64) else torch.float32
    depth = depth.to(dtype)
    size = (photo.shape[-2], photo.shape[-1])
    projection = ReferenceProjection.between(target, reference.resized(*size), depth)
    landing = land(projection, fill_depth(depth))
    visibility = landing.inside
    if alpha is None:
        visibility = visibility * usable_depth(depth)
    else:
        visibility = visibility * alpha.to(dtype).clamp(0, 1)
    if reference_depth is not None:
        checked = fill_depth(depth if rendered_depth is None else rendered_depth.to(dtype))
        visibility = visibility * depth_consistency(projection, checked, reference_depth.to(dtype), tolerance)
    # What 8 bits cannot tell from nothing is nothing; left in, numbers near zero compute tens of times slower.
    visibility = torch.where(visibility < FAINTEST, 0.0, visibility)
    footprint = _median_footprint(landing) if footprint is None else footprint
    photo = _shrink_photo(photo, footprint, dtype)
    if render is None:
        return Warped(read_at(photo, landing, size, visibility, interpolation), visibility)
    render = _shrink_photo(render, footprint * render.shape[-1] / size[1], dtype)
    colour, rendered = read_both(photo, render, landing, size, visibility, interpolation)
    return Warped(colour, visibility, rendered)


def footprint_between(target: Camera, depth: Float[Tensor, "1 h w"], reference: Camera) -> float:
    """The median distance in a reference, in its pixels, between pixels that are neighbours in the target.

    Args:
        target: camera of the grid.
        depth: z of the target, > 0 and finite.
        reference: camera of the photo, of its size.
    """
    return _median_footprint(land(ReferenceProjection.between(target, reference, depth), depth))


def _median_footprint(landing: Landing) -> float:
    """The median distance in the reference between pixels that are neighbours in the target, in the reference's pixels.

    It is taken over some 4,000 pixels, evenly spread.
    """
    height, width = landing.x.shape[-2:]
    if min(height, width) < 2:
        return 1.0
    step = max(1, math.isqrt(height * width // SAMPLED))
    here = (0, slice(0, height - 1, step), slice(0, width - 1, step))
    right, below = (here[0], here[1], slice(1, width, step)), (here[0], slice(1, height, step), here[2])
    (ax, ay), (bx, by) = ((landing.x[at] - landing.x[here], landing.y[at] - landing.y[here]) for at in (right, below))
    area = (ax * by - bx * ay).abs()[landing.inside[here] > 0]
    return float(area.detach().median().sqrt()) if area.numel() else 1.0


def _shrink_photo(
    photo: Float[Tensor, "3 _ _"] | UInt8[Tensor, "3 _ _"], footprint: float, dtype: torch.dtype
) -> Float[Tensor, "3 _ _"] | UInt8[Tensor, "3 _ _"]:
    """The photo at the resolution at which it is read, antialiased. Where that is about its own, 8 bits stay."""
    if footprint < FINER:
        return photo if photo.dtype == torch.uint8 else photo.to(dtype)
    size = [max(1, round(side / footprint)) for side in photo.shape[-2:]]
    return F.interpolate(photo[None].to(dtype), size=size, mode="bilinear", antialias=True, align_corners=False)[0]
