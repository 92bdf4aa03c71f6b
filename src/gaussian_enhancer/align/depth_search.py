"""Refinement of rendered depth by a local search that compares references with the render.

Axes: h height, w width of the target; p height, q width of a reference; m hypotheses of depth.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.depth_smoothing import smooth_depth
from gaussian_enhancer.align.exposure import fit_colour
from gaussian_enhancer.align.photo_consistency import photometric_difference
from gaussian_enhancer.align.projection import (
    IN_FRONT,
    ReferenceProjection,
    can_use_kernels,
    kernel_image,
    kernel_projection,
    land,
    read_at,
    sample_image,
)
from gaussian_enhancer.align.reproject import Warped, fill_depth
from gaussian_enhancer.types import Camera, usable_depth

TINY = 1e-8
"""Added to variances of colour, so that rounding where photos are equal does not grow under the root."""
DEAREST = 4.0
"""Cost of a hypothesis that no reference sees; larger than any difference of colours."""


@dataclass(frozen=True)
class Search:
    """Range and step of a depth search around the rendered depth.

    Args:
        span: largest relative change, > 0.
        hypotheses: number of multipliers, odd.
        window: side of the square of samples that is compared, odd.
        penalty: cost of the largest change, in colour units.
        stride: pixels between samples; between them the change is interpolated.
        inconsistency: what the photos' difference from each other counts beside their renders' from the target's.
        photo_consistency: mean colour difference to the render over 7x7 samples beyond which a reference, read at the
            depth that is there, has no say; None lets all speak, as it must be where that depth may be far off.
    """

    span: float
    hypotheses: int
    window: int = 5
    penalty: float = 0.005
    stride: int = 1
    inconsistency: float = 0.0
    photo_consistency: float | None = None


DepthKind = Literal["surface", "expected", "exact"]
"""Kind of a target's depth: the splat's median z, its mean z (between the surfaces that blend), or exact."""

SEARCHES: dict[DepthKind, tuple[Search, ...]] = {
    "surface": (Search(0.03, 7, window=7, penalty=0.002, stride=2, inconsistency=1.0, photo_consistency=0.1),),
    "expected": (Search(0.15, 25), Search(0.01, 7)),
    "exact": (),
}
"""Search range of each kind; a wide search around nearly correct depth finds more wrong matches than right ones."""


@dataclass(frozen=True)
class Source:
    """A reference view that depth hypotheses are compared in.

    Args:
        camera: where it was taken from, of the photo's size.
        photo: colours in [0, 1], at any resolution, in the exposure of its render.
        render: the splat's own of the same view, of any size; None where unknown: then the photo, its colours fitted to
            the target's, stands in.
    """

    camera: Camera
    photo: Float[Tensor, "3 _ _"]
    render: Float[Tensor, "3 _ _"] | None = None


@dataclass(frozen=True)
class _Seen:
    """A reference, prepared for the search.

    Args:
        projection: of the target's samples.
        photo: of a size that is not finer than the target, in the render's exposure.
        render: the splat's of the same view, alike; the photo where there is none.
        colours: gain and offset per channel of both to the target's colours.
        counts: 1 for samples at which the reference counts, 0 elsewhere.
    """

    projection: ReferenceProjection
    photo: Float[Tensor, "3 p q"]
    render: Float[Tensor, "3 p q"]
    colours: Float[Tensor, "3 2"]
    counts: Float[Tensor, "1 h w"]


def refine_depth(
    target: Camera,
    depth: Float[Tensor, "1 h w"],
    render: Float[Tensor, "3 h w"],
    sources: Sequence[Source],
    kind: DepthKind = "surface",
    smooth: bool = True,
    consistent: bool = True,
) -> Float[Tensor, "1 h w"]:
    """Depth near the rendered one at which references agree best with the render and with each other.

    The splat's surface is smoothed first (`smooth_depth`): median depth jumps from Gaussian to Gaussian.

    A plane sweep relative to the rendered surface: for each multiplier m = (1 + span)^k, k in [-1, 1], the cost of a
    sample is, over the references that see it, the mean absolute difference of their renders to the target's, plus
    inconsistency x the standard deviation of their photos (where one alone sees it, that difference once more). It is
    averaged over a window, and penalty x |k| is added; the smallest wins, with a parabola between its neighbours. What
    the splat blurs its renders cannot place, but photos can. Where no reference sees the surface, depth stays.

    Args:
        target: camera of the render.
        depth: rendered z, scene units; holes are filled from their neighbours, and stay holes.
        render: the target's colours, [0, 1].
        sources: the references; without any, depth is not searched.
        kind: of the depth; decides which searches are made, one after the other, each around the last one's result.
        smooth: give a surface that is one smoothness; without effect on the other kinds.
        consistent: let the photos' difference from each other count, as far as the kind's searches say.
    """
    if smooth and kind == "surface":
        valid = usable_depth(depth)
        depth = torch.where(valid, smooth_depth(fill_depth(depth).to(render.dtype), render).to(depth.dtype), depth)
    for how in SEARCHES[kind] if sources else ():
        how = how if consistent else replace(how, inconsistency=0.0)
        z = fill_depth(depth).to(render.dtype)[..., :: how.stride, :: how.stride].contiguous()
        image = render[..., :: how.stride, :: how.stride].contiguous()
        source_differences = [_prepare_source(target, z, image, source, how) for source in sources]
        change = (_search_compiled if can_use_kernels(z, image) else search)(z, image, source_differences, how)
        change = _interpolate_change(change, how.stride, depth.shape[-2], depth.shape[-1])
        depth = depth * torch.exp(change * math.log1p(how.span)).to(depth.dtype)
    return depth


def search(
    z: Float[Tensor, "1 h w"], image: Float[Tensor, "3 h w"], seen: Sequence[_Seen], how: Search
) -> Float[Tensor, "1 h w"]:
    """The cheapest step k of each sample; readable twin of the compiled kernels, on any device."""
    steps = torch.linspace(-1, 1, how.hypotheses, dtype=z.dtype, device=z.device)
    multipliers = torch.exp(steps * math.log1p(how.span))[:, None, None]
    count, difference, squares = z.new_zeros(3, how.hypotheses, 1, *z.shape[-2:])
    total = z.new_zeros(how.hypotheses, 3, *z.shape[-2:])
    for one in seen:
        landing = land(one.projection, z * multipliers)
        inside = (landing.inside * one.counts)[:, None]
        away = (_apply_colours(sample_image(one.photo, landing.x, landing.y), one.colours) - image) * inside
        count, total, squares = count + inside, total + away, squares + away.square().mean(1, keepdim=True)
        rendered = (_apply_colours(sample_image(one.render, landing.x, landing.y), one.colours) - image) * inside
        difference = difference + rendered.abs().mean(1, keepdim=True)
    n = count.clamp_min(1)
    mean = difference / n
    variance = (squares - total.square().mean(1, keepdim=True) / n).clamp_min(0) / (n - 1).clamp_min(1)
    cost = mean + how.inconsistency * torch.where(count > 1, (variance + TINY).sqrt(), mean)
    weight = (count > 0).to(cost)
    summed, share = _window_mean((cost * weight)[:, 0], how.window), _window_mean(weight[:, 0], how.window)
    # A hypothesis that fewer samples see is not cheaper for it: each is judged by the mean of those that do.
    visible = share > 0.1
    mean = torch.where(visible, summed / share.clamp_min(1e-6) + how.penalty * steps.abs()[:, None, None], DEAREST)
    return torch.where(visible[how.hypotheses // 2], _refine_minimum(mean, steps), 0.0)[None]


def _search_compiled(
    z: Float[Tensor, "1 h w"], image: Float[Tensor, "3 h w"], seen: Sequence[_Seen], how: Search
) -> Float[Tensor, "1 h w"]:
    """The same by compiled kernels."""
    from gaussian_enhancer.align.depth_search_kernels import find_costs, find_valleys
    from gaussian_enhancer.splat.compiled import kernel_lock

    steps = np.linspace(-1, 1, how.hypotheses, dtype=np.float32)
    multipliers = np.exp(steps * np.float32(math.log1p(how.span)))
    cost, weight = np.empty((2, *z.shape[-2:], how.hypotheses), np.float32)
    best = np.empty(z.shape[-2:], np.float32)
    matrices, offsets = (
        np.stack(one) for one in zip(*(kernel_projection(one.projection)[:2] for one in seen), strict=True)
    )
    sizes = np.array([(one.projection.width, one.projection.height) for one in seen])
    with kernel_lock:
        images, starts = _side_by_side(seen)
        places = matrices, offsets, sizes, starts, np.float32(IN_FRONT)
        colours = images, kernel_image(torch.cat([one.counts for one in seen])), _interleaved_channels(image)
        costs = np.float32(how.inconsistency), np.float32(TINY), cost, weight
        find_costs(kernel_image(z[0]), multipliers, *places, *colours, *costs)
        find_valleys(cost, weight, steps, np.float32(how.penalty), np.float32(DEAREST), how.window // 2, best)
    return torch.from_numpy(best)[None]


def _side_by_side(seen: Sequence[_Seen]) -> tuple[np.ndarray, np.ndarray]:
    """All references' pixels in the target's colours, photo and render side by side, and where each reference begins.

    A spare row and pixel follow each, since the kernel reads the pixels after the last without counting them.
    """
    from gaussian_enhancer.align.depth_search_kernels import pack

    rows = [(one.projection.height + 1) * one.projection.width + 1 for one in seen]
    starts = np.cumsum([0, *rows[:-1]])
    images = np.empty((sum(rows), 6), np.float32)
    for start, length, one in zip(starts, rows, seen, strict=True):
        count = one.projection.height * one.projection.width
        pixels = images[start : start + count].reshape(*one.photo.shape[-2:], 6)
        pack(kernel_image(one.photo), kernel_image(one.render), kernel_image(one.colours), pixels)
        images[start + count : start + length] = 0
    return images, starts


def _prepare_source(
    target: Camera,
    z: Float[Tensor, "1 h w"],
    image: Float[Tensor, "3 h w"],
    source: Source,
    how: Search,
) -> _Seen:
    """Prepare a reference: resized to at most the target's resolution, colours fitted through the rendered depth."""
    ratio = float(source.camera.resized(*source.photo.shape[-2:]).K[0, 0] / target.K[0, 0])
    height, width = (max(1, round(side / max(1.0, ratio))) for side in source.photo.shape[-2:])
    photo = _resized(source.photo.to(image.dtype), height, width)
    render = photo if source.render is None else _resized(source.render.to(image.dtype), height, width)
    projection = ReferenceProjection.between(target, source.camera.resized(height, width), z).with_stride(how.stride)
    landing = land(projection, z)
    sampled = read_at(render, landing, (height, width), landing.inside)
    colours = fit_colour(sampled, image, landing.inside).to(photo)
    counts = landing.inside
    if how.photo_consistency is not None:
        fitted = Warped(_apply_colours(sampled, colours), counts)
        counts = counts * (photometric_difference(fitted, image) < how.photo_consistency)
    return _Seen(projection, photo, render, colours, counts)


def _apply_colours(image: Float[Tensor, "*m 3 _ _"], colours: Float[Tensor, "3 2"]) -> Float[Tensor, "*m 3 _ _"]:
    return image * colours[:, :1, None] + colours[:, 1:, None]


def _interpolate_change(
    change: Float[Tensor, "1 p q"], stride: int, height: int, width: int
) -> Float[Tensor, "1 {height} {width}"]:
    """The change of every pixel, linear between samples; beyond the last, the last one's."""
    if stride == 1:
        return change
    for axis, side in ((1, height), (2, width)):
        positions = torch.arange(side, device=change.device)
        before, after = positions // stride, (positions // stride + 1).clamp_max(change.shape[axis] - 1)
        share = ((positions % stride) / stride).to(change)
        share = share[:, None] if axis == 1 else share
        change = change.index_select(axis, before) * (1 - share) + change.index_select(axis, after) * share
    return change


def _refine_minimum(cost: Float[Tensor, "m h w"], steps: Float[Tensor, " m"]) -> Float[Tensor, "h w"]:
    """The step of least cost, moved to the minimum of the parabola through it and its neighbours."""
    index = cost.argmin(0, keepdim=True).clamp(1, len(steps) - 2)
    before, centre, after = (cost.gather(0, index + k)[0] for k in (-1, 0, 1))
    curvature = before - 2 * centre + after
    shift = torch.where(curvature > 1e-9, 0.5 * (before - after) / curvature.clamp_min(1e-9), 0.0).clamp(-1, 1)
    return steps[index[0]] + shift * (steps[1] - steps[0])


def _window_mean(value: Float[Tensor, "m h w"], side: int) -> Float[Tensor, "m h w"]:
    """Mean over a square window, smaller at the border."""
    return F.avg_pool2d(value[None], side, stride=1, padding=side // 2, count_include_pad=False)[0]


def _resized(image: Float[Tensor, "c _ _"], height: int, width: int) -> Float[Tensor, "c {height} {width}"]:
    """The image on another grid, antialiased."""
    if image.shape[-2:] == (height, width):
        return image
    return F.interpolate(image[None], size=(height, width), mode="bilinear", antialias=True, align_corners=False)[0]


def _interleaved_channels(image: Float[Tensor, "c h w"]) -> np.ndarray:
    """A pixel's channels side by side, as the kernels read them."""
    return np.ascontiguousarray(image.permute(1, 2, 0).numpy())
