"""Refinement of rendered depth by a local search that compares references with the render.

Axes: h height, w width of the target; p height, q width of a reference; m depth hypotheses.
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
    MIN_RELATIVE_Z,
    ReferenceProjection,
    can_use_kernels,
    kernel_projection,
    project_pixels,
    sample_image,
    sample_projected,
)
from gaussian_enhancer.align.reproject import Warped, fill_depth
from gaussian_enhancer.types import Camera, numpy_view, usable_depth

VARIANCE_EPSILON = 1e-8
"""Added to colour variances, since the square root would amplify rounding errors where photos are equal."""
INVISIBLE_COST = 4.0
"""Cost of a hypothesis that is visible in no reference; larger than any colour difference."""
LARGE_IMAGE = 2**18
"""Number of pixels above which `Search.large_stride` applies."""


@dataclass(frozen=True)
class Search:
    """Range and step of a depth search around the rendered depth.

    Args:
        span: largest relative change, > 0.
        hypotheses: number of multipliers, odd.
        window: side in samples of the square over which costs are averaged, odd.
        penalty: cost of the largest change, in colour units.
        stride: pixels between samples; between samples the change is interpolated.
        large_stride: the stride for images of more than `LARGE_IMAGE` pixels; None: the same.
        inconsistency: weight of the photos' standard deviation, relative to the renders' difference from the target.
        photo_consistency: mean colour difference to the render over 7x7 samples above which a reference is ignored at
            a sample. It is measured at the initial depth. None ignores no reference, which is required where the
            initial depth may be far off.
    """

    span: float
    hypotheses: int
    window: int = 5
    penalty: float = 0.005
    stride: int = 1
    inconsistency: float = 0.0
    photo_consistency: float | None = None
    large_stride: int | None = None

    def for_pixels(self, count: int) -> "Search":
        """The search of an image of this number of pixels, with its stride."""
        if self.large_stride is None or count <= LARGE_IMAGE:
            return self
        return replace(self, stride=self.large_stride)


DepthKind = Literal["surface", "expected", "exact"]
"""Kind of a target's depth: "surface" is the splat's median z, "expected" its mean z, which lies between the surfaces
that blend; "exact" is exact depth."""

SURFACE_SEARCHES = (
    Search(0.03, 7, window=7, penalty=0.002, stride=2, inconsistency=1.0, photo_consistency=0.1, large_stride=4),
    Search(0.015, 7, penalty=0.002, stride=2, inconsistency=1.0, photo_consistency=0.1, large_stride=4),
)
SEARCHES: dict[DepthKind, tuple[Search, ...]] = {
    "surface": SURFACE_SEARCHES,
    "expected": (Search(0.15, 25, stride=2), *SURFACE_SEARCHES),
    "exact": (),
}
"""Searches of each kind of depth, one after the other. A wide search around nearly correct depth finds more wrong than
right matches."""


@dataclass(frozen=True)
class Source:
    """A reference view in which depth hypotheses are compared.

    Args:
        camera: camera of the photo, with its size.
        photo: colours in [0, 1], at any resolution, in the exposure of its render.
        render: the splat's render of the same view, of any size; None if unknown. Then the photo is used instead, with
            its colours fitted to the target's.
    """

    camera: Camera
    photo: Float[Tensor, "3 _ _"]
    render: Float[Tensor, "3 _ _"] | None = None


@dataclass(frozen=True)
class _PreparedReference:
    """A reference prepared for the search.

    Args:
        projection: projection of the target's samples into the reference.
        photo: photo at most as fine as the target, in the render's exposure.
        render: the splat's render of the same view at the same size; the photo if there is no render.
        transform: gain and offset per channel from photo and render to the target's colours.
        mask: 1 for samples at which the reference is used, 0 elsewhere.
    """

    projection: ReferenceProjection
    photo: Float[Tensor, "3 p q"]
    render: Float[Tensor, "3 p q"]
    transform: Float[Tensor, "3 2"]
    mask: Float[Tensor, "1 h w"]


def refine_depth(
    target: Camera,
    depth: Float[Tensor, "1 h w"],
    render: Float[Tensor, "3 h w"],
    sources: Sequence[Source],
    kind: DepthKind = "surface",
    smooth: bool = True,
    consistent: bool = True,
) -> Float[Tensor, "1 h w"]:
    """Find the depth near the rendered one at which references agree best with the render and with each other.

    Depth is smoothed before each search (`smooth_depth`): median depth jumps from Gaussian to Gaussian, and mean depth
    follows every Gaussian that blends in front of a surface. Exact depth is neither smoothed nor searched.

    The search is a plane sweep relative to the rendered surface, with multipliers m = (1 + span)^k, k in [-1, 1]. The
    cost of a sample is computed over the references in which it is visible. It is the mean absolute difference of
    their renders to the target's, plus inconsistency x the standard deviation of their photos (if only one reference
    shows the sample, that difference again). The cost is averaged over a window, and penalty x |k| is added. The
    smallest cost wins, refined by a parabola through its neighbours. Photos locate detail that the splat blurs in its
    renders. Depth is unchanged where no reference shows the surface.

    Args:
        target: camera of the render.
        depth: rendered z in scene units; holes are filled from their neighbours for the search, and remain holes.
        render: colours of the target, [0, 1].
        sources: the references; if there are none, depth is smoothed once and not searched.
        kind: kind of the depth; it determines the searches. Each search starts from the result of the previous one.
        smooth: smooth depth before each search.
        consistent: include the photos' differences from each other, with the weight that the searches define.
    """
    for search in SEARCHES[kind]:
        if smooth:
            smoothed = smooth_depth(fill_depth(depth).to(render.dtype), render).to(depth.dtype)
            depth = torch.where(usable_depth(depth), smoothed, depth)
        if not sources:
            break
        search = search.for_pixels(depth.numel())
        search = search if consistent else replace(search, inconsistency=0.0)
        z = fill_depth(depth).to(render.dtype)[..., :: search.stride, :: search.stride].contiguous()
        image = render[..., :: search.stride, :: search.stride].contiguous()
        prepared = [_prepare_source(target, z, image, source, search) for source in sources]
        change = (_search_compiled if can_use_kernels(z, image) else search_torch)(z, image, prepared, search)
        change = _interpolate_change(change, search.stride, depth.shape[-2], depth.shape[-1])
        depth = depth * torch.exp(change * math.log1p(search.span)).to(depth.dtype)
    return depth


def search_torch(
    z: Float[Tensor, "1 h w"], image: Float[Tensor, "3 h w"], references: Sequence[_PreparedReference], search: Search
) -> Float[Tensor, "1 h w"]:
    """The step k of least cost at each sample; readable twin of the compiled kernels, for any device."""
    steps = torch.linspace(-1, 1, search.hypotheses, dtype=z.dtype, device=z.device)
    multipliers = torch.exp(steps * math.log1p(search.span))[:, None, None]
    count, difference, squares = z.new_zeros(3, search.hypotheses, 1, *z.shape[-2:])
    total = z.new_zeros(search.hypotheses, 3, *z.shape[-2:])
    for reference in references:
        projected = project_pixels(reference.projection, z * multipliers)
        visible = (projected.inside * reference.mask)[:, None]
        deviation, render_deviation = (
            (_apply_colours(sample_image(source, projected.x, projected.y), reference.transform) - image) * visible
            for source in (reference.photo, reference.render)
        )
        count, total, squares = count + visible, total + deviation, squares + deviation.square().mean(1, keepdim=True)
        difference = difference + render_deviation.abs().mean(1, keepdim=True)
    n = count.clamp_min(1)
    mean = difference / n
    variance = (squares - total.square().mean(1, keepdim=True) / n).clamp_min(0) / (n - 1).clamp_min(1)
    cost = mean + search.inconsistency * torch.where(count > 1, (variance + VARIANCE_EPSILON).sqrt(), mean)
    weight = (count > 0).to(cost)
    window_cost, window_share = (_window_mean(image[:, 0], search.window) for image in (cost * weight, weight))
    # Costs are averaged over the visible samples only, so that a hypothesis with fewer of them has no lower cost.
    visible = window_share > 0.1
    penalty = search.penalty * steps.abs()[:, None, None]
    mean = torch.where(visible, window_cost / window_share.clamp_min(1e-6) + penalty, INVISIBLE_COST)
    return torch.where(visible[search.hypotheses // 2], _refine_minimum(mean, steps), 0.0)[None]


def _search_compiled(
    z: Float[Tensor, "1 h w"], image: Float[Tensor, "3 h w"], references: Sequence[_PreparedReference], search: Search
) -> Float[Tensor, "1 h w"]:
    """Compiled version of `search_torch`."""
    from gaussian_enhancer.align.depth_search_kernels import find_cost_minima, find_costs
    from gaussian_enhancer.compiled import kernel_lock

    steps = np.linspace(-1, 1, search.hypotheses, dtype=np.float32)
    multipliers = np.exp(steps * np.float32(math.log1p(search.span)))
    cost, weight = np.empty((2, *z.shape[-2:], search.hypotheses), np.float32)
    best = np.empty(z.shape[-2:], np.float32)
    projections = [kernel_projection(reference.projection) for reference in references]
    matrices, offsets = (np.stack([projection[k] for projection in projections]) for k in range(2))
    sizes = np.array([(reference.projection.width, reference.projection.height) for reference in references])
    with kernel_lock:
        images, starts = _pack_references(references)
        geometry = matrices, offsets, sizes, starts, np.float32(MIN_RELATIVE_Z)
        masks = numpy_view(torch.cat([reference.mask for reference in references]))
        cost_settings = np.float32(search.inconsistency), np.float32(VARIANCE_EPSILON), cost, weight
        find_costs(
            numpy_view(z[0]), multipliers, *geometry, images, masks, _interleaved_channels(image), *cost_settings
        )
        limits = np.float32(search.penalty), np.float32(INVISIBLE_COST), search.window // 2
        find_cost_minima(cost, weight, steps, *limits, best)
    return torch.from_numpy(best)[None]


def _pack_references(references: Sequence[_PreparedReference]) -> tuple[np.ndarray, np.ndarray]:
    """Pack all references' pixels in the target's colours, with photo and render as six channels; return the offsets.

    Each reference is followed by an extra row and pixel, since the kernel reads them, with weight zero, at the border.
    """
    from gaussian_enhancer.align.depth_search_kernels import pack

    lengths = [(reference.projection.height + 1) * reference.projection.width + 1 for reference in references]
    starts = np.cumsum([0, *lengths[:-1]])
    images = np.empty((sum(lengths), 6), np.float32)
    for start, length, reference in zip(starts, lengths, references, strict=True):
        count = reference.projection.height * reference.projection.width
        pixels = images[start : start + count].reshape(*reference.photo.shape[-2:], 6)
        pack(numpy_view(reference.photo), numpy_view(reference.render), numpy_view(reference.transform), pixels)
        images[start + count : start + length] = 0
    return images, starts


def _prepare_source(
    target: Camera,
    z: Float[Tensor, "1 h w"],
    image: Float[Tensor, "3 h w"],
    source: Source,
    search: Search,
) -> _PreparedReference:
    """Prepare a reference: resize it to at most the target's resolution, and fit its colours at the rendered depth."""
    ratio = float(source.camera.resized(*source.photo.shape[-2:]).K[0, 0] / target.K[0, 0])
    height, width = (max(1, round(side / max(1.0, ratio))) for side in source.photo.shape[-2:])
    photo = _resize(source.photo.to(image.dtype), height, width)
    render = photo if source.render is None else _resize(source.render.to(image.dtype), height, width)
    projection = ReferenceProjection.between(target, source.camera.resized(height, width), z).with_stride(search.stride)
    projected = project_pixels(projection, z)
    sampled = sample_projected(render, projected, (height, width), projected.inside)
    transform = fit_colour(sampled, image, projected.inside).to(photo)
    mask = projected.inside
    if search.photo_consistency is not None:
        fitted = Warped(_apply_colours(sampled, transform), mask)
        mask = mask * (photometric_difference(fitted, image) < search.photo_consistency)
    return _PreparedReference(projection, photo, render, transform, mask)


def _apply_colours(image: Float[Tensor, "*m 3 _ _"], transform: Float[Tensor, "3 2"]) -> Float[Tensor, "*m 3 _ _"]:
    return image * transform[:, :1, None] + transform[:, 1:, None]


def _interpolate_change(
    change: Float[Tensor, "1 p q"], stride: int, height: int, width: int
) -> Float[Tensor, "1 {height} {width}"]:
    """Interpolate the change linearly between samples; pixels after the last sample take its value."""
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
    """The step of least cost, refined to the minimum of a parabola through it and its neighbours."""
    index = cost.argmin(0, keepdim=True).clamp(1, len(steps) - 2)
    before, centre, after = (cost.gather(0, index + k)[0] for k in (-1, 0, 1))
    curvature = before - 2 * centre + after
    shift = torch.where(curvature > 1e-9, 0.5 * (before - after) / curvature.clamp_min(1e-9), 0.0).clamp(-1, 1)
    return steps[index[0]] + shift * (steps[1] - steps[0])


def _window_mean(value: Float[Tensor, "m h w"], side: int) -> Float[Tensor, "m h w"]:
    """Mean over a square window, which is cropped at the border."""
    return F.avg_pool2d(value[None], side, stride=1, padding=side // 2, count_include_pad=False)[0]


def _resize(image: Float[Tensor, "c _ _"], height: int, width: int) -> Float[Tensor, "c {height} {width}"]:
    """The image resized with antialiasing."""
    if image.shape[-2:] == (height, width):
        return image
    return F.interpolate(image[None], size=(height, width), mode="bilinear", antialias=True, align_corners=False)[0]


def _interleaved_channels(image: Float[Tensor, "c h w"]) -> np.ndarray:
    """The image with channels last, as a contiguous array for the kernels."""
    return np.ascontiguousarray(image.permute(1, 2, 0).numpy())
