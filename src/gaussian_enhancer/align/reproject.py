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
    ProjectedPixels,
    ReferenceProjection,
    depth_consistency,
    project_pixels,
    sample_projected,
    sample_projected_pair,
)
from gaussian_enhancer.types import FARTHEST_DEPTH, Camera, usable_depth

FAINTEST = 1 / 255
"""Visibility below which a pixel counts as not visible: one step of 8 bits."""
DOWNSAMPLING_FOOTPRINT = 1.2
"""Footprint in photo pixels of a target pixel from which on a photo is downsampled before it is sampled."""
FOOTPRINT_SAMPLES = 2**12
"""Approximate number of pixels from which the footprint is estimated."""


@dataclass(frozen=True)
class Warped:
    """A reference on the target's grid.

    Args:
        colour: colours of the photo, 0 where not visible.
        visibility: how surely the reference shows the target's surface, in [0, 1].
        render: the splat's render of the reference's view, warped in the same way; None if unknown.
    """

    colour: Float[Tensor, "3 h w"]
    visibility: Float[Tensor, "1 h w"]
    render: Float[Tensor, "3 h w"] | None = None


def fill_depth(depth: Float[Tensor, "1 h w"]) -> Float[Tensor, "1 h w"]:
    """Fill the holes of a depth map with averages of valid neighbours from the finest pyramid level that has any.

    Push and pull over a pyramid (Gortler et al., SIGGRAPH 1996) on inverse depth, so that a hole between near and far
    surfaces is not biased by the scale of their depths. A map without any valid depth becomes 1 everywhere.

    Args:
        depth: z in scene units; pixels that are not `usable_depth` are holes.
    """
    minimum, maximum = depth.aminmax()  # both are NaN if any value is NaN
    if bool((minimum > 0) & (maximum < torch.inf) & (maximum <= FARTHEST_DEPTH)):
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

    visibility = inside the photo x in front of the camera x alpha x exp(-((z - z') / (tolerance z))^2 / 2), where z is
    the point's depth in the reference and z' the depth that the reference itself renders there. A photo finer than the
    target is first downsampled with antialiasing.

    Args:
        target: camera of the grid to fill.
        depth: rendered z of the target in scene units; holes are filled from their neighbours for the warp.
        reference: camera of the photo; scaled to the photo's size if the sizes differ.
        photo: reference colours at any resolution, [0, 1]; 8-bit colours are warped unchanged, [0, 255].
        reference_depth: rendered z of the reference at any resolution; None disables the occlusion check.
        alpha: rendered opacity of the target; None counts holes of the depth as invisible.
        tolerance: relative depth difference of one standard deviation, > 0.
        rendered_depth: the target's depth before refinement, which is compared with the reference's rendered depth;
            None means ``depth``.
        render: the splat's render of the reference's view, at any resolution, to be warped in the same way.
        interpolation: interpolation of photo and render between pixels.
        footprint: distance in photo pixels between projections of neighbouring target pixels; None measures it.
    """
    dtype = depth.dtype if depth.dtype in (torch.float32, torch.float64) else torch.float32
    depth = depth.to(dtype)
    size = (photo.shape[-2], photo.shape[-1])
    projection = ReferenceProjection.between(target, reference.resized(*size), depth)
    projected = project_pixels(projection, fill_depth(depth))
    visibility = projected.inside
    if alpha is None:
        visibility = visibility * usable_depth(depth)
    else:
        visibility = visibility * alpha.to(dtype).clamp(0, 1)
    if reference_depth is not None:
        compared_depth = fill_depth(depth if rendered_depth is None else rendered_depth.to(dtype))
        visibility = visibility * depth_consistency(projection, compared_depth, reference_depth.to(dtype), tolerance)
    # Arithmetic on denormal numbers is tens of times slower.
    visibility = torch.where(visibility < FAINTEST, 0.0, visibility)
    footprint = _median_footprint(projected) if footprint is None else footprint
    photo = _shrink_photo(photo, footprint, dtype)
    if render is None:
        return Warped(sample_projected(photo, projected, size, visibility, interpolation), visibility)
    render = _shrink_photo(render, footprint * render.shape[-1] / size[1], dtype)
    colour, rendered = sample_projected_pair(photo, render, projected, size, visibility, interpolation)
    return Warped(colour, visibility, rendered)


def footprint_between(target: Camera, depth: Float[Tensor, "1 h w"], reference: Camera) -> float:
    """Median distance, in pixels of a reference, between the projections of neighbouring target pixels.

    Args:
        target: camera of the grid.
        depth: z of the target, positive and finite.
        reference: camera of the photo, with its size.
    """
    return _median_footprint(project_pixels(ReferenceProjection.between(target, reference, depth), depth))


def _median_footprint(projected: ProjectedPixels) -> float:
    """Median distance, in pixels of the reference, between the projections of neighbouring target pixels.

    The median is taken over some 4,000 evenly spread pixels.
    """
    height, width = projected.x.shape[-2:]
    if min(height, width) < 2:
        return 1.0
    step = max(1, math.isqrt(height * width // FOOTPRINT_SAMPLES))
    origin = (0, slice(0, height - 1, step), slice(0, width - 1, step))
    right, below = (origin[0], origin[1], slice(1, width, step)), (origin[0], slice(1, height, step), origin[2])
    x, y = projected.x, projected.y
    (ax, ay), (bx, by) = ((x[pixels] - x[origin], y[pixels] - y[origin]) for pixels in (right, below))
    area = (ax * by - bx * ay).abs()[projected.inside[origin] > 0]
    return float(area.detach().median().sqrt()) if area.numel() else 1.0


def _shrink_photo(
    photo: Float[Tensor, "3 _ _"] | UInt8[Tensor, "3 _ _"], footprint: float, dtype: torch.dtype
) -> Float[Tensor, "3 _ _"] | UInt8[Tensor, "3 _ _"]:
    """The photo, downsampled with antialiasing to the resolution of sampling; else 8-bit photos stay 8-bit."""
    if footprint < DOWNSAMPLING_FOOTPRINT:
        return photo if photo.dtype == torch.uint8 else photo.to(dtype)
    size = [max(1, round(side / footprint)) for side in photo.shape[-2:]]
    return F.interpolate(photo[None].to(dtype), size=size, mode="bilinear", antialias=True, align_corners=False)[0]
