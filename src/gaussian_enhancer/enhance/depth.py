"""Bettering rendered depth by what the references show, before they are warped through it.

Axes: h height, w width of the target; p height, q width of a reference; m hypotheses of depth.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.enhance.colour import fit_colour
from gaussian_enhancer.enhance.projection import Projection, array, arrays, compiled, land, look_up, read_at
from gaussian_enhancer.enhance.reproject import fill_depth
from gaussian_enhancer.enhance.smooth import smooth_depth
from gaussian_enhancer.types import Camera, usable


@dataclass(frozen=True)
class Search:
    """How finely depth is searched around what is there.

    Args:
        span: largest relative change, > 0.
        hypotheses: number of multipliers, odd.
        window: side of the square that is compared, in pixels, odd.
        penalty: cost of the largest change, in colour units.
    """

    span: float
    hypotheses: int
    window: int = 5
    penalty: float = 0.005


DepthKind = Literal["surface", "expected", "exact"]
"""What a target's depth is: the splat's median z, its mean z, which lies between surfaces that mix, or the truth."""

SEARCHES: dict[DepthKind, tuple[Search, ...]] = {
    "surface": (Search(0.02, 7, window=9),),
    "expected": (Search(0.15, 25), Search(0.01, 7)),
    "exact": (),
}
"""How far each kind is searched; a wide search around what is nearly right finds more that is wrong than right."""


@dataclass(frozen=True)
class _Seen:
    """A reference as the search sees it: projection of the target's pixels, photo of fitting size and colours."""

    projection: Projection
    photo: Float[Tensor, "3 p q"]


def refine_depth(
    target: Camera,
    depth: Float[Tensor, "1 h w"],
    render: Float[Tensor, "3 h w"],
    cameras: Sequence[Camera],
    photos: Sequence[Float[Tensor, "3 _ _"]],
    kind: DepthKind = "surface",
    smooth: bool = True,
) -> Float[Tensor, "1 h w"]:
    """Depth at which the references agree best with the render, within a span around what was rendered.

    The splat's surface is smoothed first (`smooth_depth`): median depth jumps from Gaussian to Gaussian.

    A plane sweep relative to the rendered surface: for each multiplier m = (1 + span)^k, k in [-1, 1], the cost is
    the references' mean absolute colour difference to the render over a window plus penalty x |k|; the smallest wins,
    with a parabola between its neighbours. Where no reference sees the surface, depth stays.

    Args:
        target: camera of the render.
        depth: rendered z, scene units; holes are filled from their neighbours, and stay holes.
        render: the target's colours, [0, 1].
        cameras: the references' cameras.
        photos: the references' colours, [0, 1], at any resolution.
        kind: of the depth; decides which searches are made, one after the other, each around the last one's result.
        smooth: give a surface that is one smoothness; without effect on the other kinds.
    """
    if smooth and kind == "surface":
        valid = usable(depth)
        depth = torch.where(valid, smooth_depth(fill_depth(depth).to(render.dtype), render).to(depth.dtype), depth)
    for how in SEARCHES[kind] if cameras else ():
        z = fill_depth(depth).to(render.dtype)
        seen = [_seen(target, z, render, camera, photo) for camera, photo in zip(cameras, photos, strict=True)]
        change = (_search_compiled if compiled(z, render) else search)(z, render, seen, how)
        depth = depth * torch.exp(change * math.log1p(how.span)).to(depth.dtype)
    return depth


def search(
    z: Float[Tensor, "1 h w"], image: Float[Tensor, "3 h w"], seen: Sequence[_Seen], how: Search
) -> Float[Tensor, "1 h w"]:
    """The cheapest step k of each pixel; readable twin of the compiled kernels, on any device."""
    steps = torch.linspace(-1, 1, how.hypotheses, dtype=z.dtype, device=z.device)
    multipliers = torch.exp(steps * math.log1p(how.span))[:, None, None]
    cost, weight = z.new_zeros(2, how.hypotheses, *z.shape[-2:])
    for one in seen:
        landing = land(one.projection, z * multipliers)
        difference = (look_up(one.photo, landing.x, landing.y) - image).abs().mean(1)
        cost, weight = cost + difference * landing.inside, weight + landing.inside
    total, share = _window(cost, how.window), _window(weight, how.window)
    # A hypothesis that fewer references see is not cheaper for it: each is judged by the mean of those that do.
    visible = share > 0.1
    mean = torch.where(visible, total / share.clamp_min(1e-6) + how.penalty * steps.abs()[:, None, None], 1.0)
    return torch.where(visible[how.hypotheses // 2], _valley(mean, steps), 0.0)[None]


def _search_compiled(
    z: Float[Tensor, "1 h w"], image: Float[Tensor, "3 h w"], seen: Sequence[_Seen], how: Search
) -> Float[Tensor, "1 h w"]:
    """The same by compiled kernels."""
    from gaussian_enhancer.enhance.sweep_kernels import add_differences, find_valleys
    from gaussian_enhancer.splat.compiled import kernel_lock

    steps = np.linspace(-1, 1, how.hypotheses, dtype=np.float32)
    multipliers = np.exp(steps * np.float32(math.log1p(how.span)))
    cost, weight = np.zeros((2, *z.shape[-2:], how.hypotheses), np.float32)
    best = np.empty(z.shape[-2:], np.float32)
    surface, wanted = array(z[0]), _pixels(image)
    with kernel_lock:
        for one in seen:
            add_differences(surface, multipliers, *arrays(one.projection), _pixels(one.photo), wanted, cost, weight)
        find_valleys(cost, weight, steps, np.float32(how.penalty), how.window // 2, best)
    return torch.from_numpy(best)[None]


def _seen(
    target: Camera, z: Float[Tensor, "1 h w"], image: Float[Tensor, "3 h w"], camera: Camera, photo: Tensor
) -> _Seen:
    """Prepare a reference: not finer than the target, its colours fitted through the depth that is there."""
    ratio = float(camera.resized(*photo.shape[-2:]).K[0, 0] / target.K[0, 0])
    height, width = (max(1, round(side / max(1.0, ratio))) for side in photo.shape[-2:])
    photo = _resized(photo.to(image.dtype), height, width)
    projection = Projection.between(target, camera.resized(height, width), z)
    landing = land(projection, z)
    colours = fit_colour(read_at(photo, landing, (height, width), landing.inside), image, landing.inside).to(photo)
    return _Seen(projection, photo * colours[:, :1, None] + colours[:, 1:, None])


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


def _pixels(image: Float[Tensor, "3 h w"]) -> np.ndarray:
    """A pixel's channels side by side, as the kernels read them."""
    return np.ascontiguousarray(image.permute(1, 2, 0).numpy())
