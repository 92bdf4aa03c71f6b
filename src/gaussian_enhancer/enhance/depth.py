"""Bettering rendered depth by what the references show, before they are warped through it.

Axes: h height, w width of the target; p height, q width of a reference; m hypotheses of depth.
"""

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.enhance.colour import fit_colour
from gaussian_enhancer.enhance.reproject import fill_depth, look_up, projection
from gaussian_enhancer.types import Camera


def refine_depth(
    target: Camera,
    depth: Float[Tensor, "1 h w"],
    render: Float[Tensor, "3 h w"],
    cameras: Sequence[Camera],
    photos: Sequence[Float[Tensor, "3 _ _"]],
    span: float = 0.3,
    hypotheses: int = 17,
    window: int = 7,
    penalty: float = 0.01,
    shrink: int = 2,
) -> Float[Tensor, "1 h w"]:
    """Depth at which the references agree best with the render, within a span around what was rendered.

    A plane sweep relative to the rendered surface: for each multiplier m = (1 + span)^k, k in [-1, 1], the cost is
    the references' mean absolute colour difference to the render over a window plus penalty x |k|; the smallest wins,
    with a parabola between its neighbours. Where no reference sees the surface, depth stays.

    Args:
        target: camera of the render.
        depth: rendered z, scene units; holes are filled from their neighbours, and stay holes.
        render: the target's colours, [0, 1].
        cameras: the references' cameras.
        photos: the references' colours, [0, 1], at any resolution.
        span: largest relative change, > 0.
        hypotheses: number of multipliers, odd.
        window: side of the square that is compared, in pixels of the shrunk image, odd.
        penalty: cost of the largest change, in colour units.
        shrink: factor by which images are shrunk for the search.
    """
    if not cameras:
        return depth
    height, width = (max(1, side // shrink) for side in render.shape[-2:])
    small = target.resized(height, width)
    image = _resized(render, height, width)
    z = _resized(fill_depth(depth), height, width)
    steps = torch.linspace(-1, 1, hypotheses, dtype=z.dtype, device=z.device)
    multipliers = torch.exp(steps * math.log1p(span))
    cost = z.new_zeros(hypotheses, height, width)
    weight = z.new_full((hypotheses, height, width), 1e-6)
    for camera, photo in zip(cameras, photos, strict=True):
        difference, inside = _differences(small, z * multipliers[:, None, None], image, camera, photo)
        cost += _window(difference * inside, window)
        weight += _window(inside, window)
    # A hypothesis that fewer references see is not cheaper for it: each is judged by the mean of those that do.
    cost = cost / weight + penalty * steps.abs()[:, None, None]
    cost = torch.where(weight > 0.1, cost, torch.full_like(cost, 1.0))
    best = _valley(cost, steps)
    seen = weight[hypotheses // 2] > 0.1
    change = torch.where(seen, best, torch.zeros_like(best))
    change = F.interpolate(change[None, None], size=depth.shape[-2:], mode="bilinear", align_corners=False)[0]
    return depth * torch.exp(change * math.log1p(span)).to(depth.dtype)


def _differences(
    target: Camera, z: Float[Tensor, "m h w"], image: Float[Tensor, "3 h w"], camera: Camera, photo: Tensor
) -> tuple[Float[Tensor, "m h w"], Float[Tensor, "m h w"]]:
    """Absolute colour difference of a photo warped by each hypothesis, and where it lies inside the photo."""
    ratio = float(camera.resized(*photo.shape[-2:]).K[0, 0] / target.K[0, 0])
    size = [max(1, round(side / max(1.0, ratio))) for side in photo.shape[-2:]]
    photo, camera = _resized(photo.to(image.dtype), *size), camera.resized(*size)
    slopes, offset = projection(target, camera, z.dtype)
    depth = z * slopes[2] + offset[2]
    safe = depth.clamp_min(1e-6)
    x, y = (z * slopes[0] + offset[0]) / safe, (z * slopes[1] + offset[1]) / safe
    inside = ((x >= 0) & (x <= camera.width) & (y >= 0) & (y <= camera.height) & (depth > 1e-6)).to(z.dtype)
    warped = look_up(photo, x, y)
    middle = len(z) // 2
    colours = fit_colour(warped[middle], image, inside[middle][None]).to(image.dtype)
    gain, shift = colours[:, :1, None], colours[:, 1:, None]
    return (warped * gain + shift - image).abs().mean(1), inside


def _valley(cost: Float[Tensor, "m h w"], steps: Float[Tensor, " m"]) -> Float[Tensor, "h w"]:
    """The step of least cost, moved to the minimum of the parabola through it and its neighbours."""
    index = cost.argmin(0, keepdim=True).clamp(1, len(steps) - 2)
    before, here, after = (cost.gather(0, index + k)[0] for k in (-1, 0, 1))
    curvature = before - 2 * here + after
    shift = torch.where(curvature > 1e-9, 0.5 * (before - after) / curvature.clamp_min(1e-9), 0.0).clamp(-1, 1)
    return steps[index[0]] + shift * (steps[1] - steps[0])


def _window(value: Float[Tensor, "m h w"], side: int) -> Float[Tensor, "m h w"]:
    """Mean over a square window, smaller at the border."""
    return F.avg_pool2d(value[None], side, stride=1, padding=side // 2, count_include_pad=False)[0]


def _resized(image: Float[Tensor, "c _ _"], height: int, width: int) -> Float[Tensor, "c {height} {width}"]:
    """The image on another grid, antialiased."""
    if image.shape[-2:] == (height, width):
        return image
    return F.interpolate(image[None], size=(height, width), mode="bilinear", antialias=True, align_corners=False)[0]
