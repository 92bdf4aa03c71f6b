"""Alignment of references to the target's pixel grid.

Axes: r references, h height, w width of the target, H = 4 h, W = 4 w.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Protocol, get_args, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Float, Float16, UInt8
from torch import Tensor

from gaussian_enhancer.align.depth_search import SEARCHES, DepthKind, Source, refine_depth
from gaussian_enhancer.align.exposure import apply_colour, fit_colour, fit_exposure
from gaussian_enhancer.align.photo_consistency import (
    hide_inconsistent,
    photometric_difference,
    rank_references,
    reference_weight,
)
from gaussian_enhancer.align.projection import Interpolation, can_use_kernels
from gaussian_enhancer.align.reproject import Warped, fill_depth, footprint_between, reproject
from gaussian_enhancer.align.transparent import dark_transparent_pixels, mark_dark_pixels_visible
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.photos import resize
from gaussian_enhancer.types import Camera, Region, numpy_view, single_precision

NON_IMAGE_FIELDS = "name", "camera", "read_fine"
"""Fields of `LoadedView` that are not images."""
STRIP = 256
"""Number of rows of a fine grid that are warped at a time, to limit the memory for large images."""


@dataclass(frozen=True)
class LoadedView:
    """A view in memory: a target with its render, or a reference with its photo.

    Args:
        name: the view's file name.
        image: colours in [0, 1]: the render of a target, or the photo of a reference.
        camera: camera with the image's size; None if unknown.
        depth: rendered z in scene units, 0 where no surface was hit; of any size for references; None if unknown.
        alpha: rendered opacity; None if unknown.
        render: the splat's render of a reference's view, of any size; None if unknown.
        read_fine: reads a reference's 8-bit photo at a higher resolution, of any size; None if not requested.
    """

    name: str
    image: Float[Tensor, "3 h w"]
    camera: Camera | None = None
    depth: Float[Tensor, "1 _ _"] | None = None
    alpha: Float[Tensor, "1 h w"] | None = None
    render: Float[Tensor, "3 _ _"] | None = None
    read_fine: Callable[[], UInt8[Tensor, "3 _ _"]] | None = None

    @cached_property
    def exposure(self) -> Float[Tensor, "3 2"] | None:
        """Gain and offset per channel from the photo to the splat's render of its view; None without a render."""
        if self.render is None:
            return None
        return fit_exposure(resize(self.image, *self.render.shape[-2:]), self.render)

    def to_device(self, device: torch.device) -> "LoadedView":
        """The view with its images on a device. Its camera is not moved, since only a few numbers of it are read."""
        return self._map_images(lambda image: image.to(device))

    def to_single_precision(self) -> "LoadedView":
        """The view with half-precision images converted to single precision."""
        return self._map_images(single_precision)

    def _map_images(self, change: Callable[[Tensor], Tensor]) -> "LoadedView":
        """Apply a function to the view's images. If no image changes, return the same object with its cached values."""
        images = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in NON_IMAGE_FIELDS}
        changed = {name: change(image) for name, image in images.items() if image is not None}
        if all(image is images[name] for name, image in changed.items()):
            return self
        return replace(self, **changed)  # type: ignore[arg-type]


@dataclass(frozen=True)
class AlignedReferences:
    """References on the target's grid, in order of decreasing usefulness.

    Args:
        references: colours, 0 where not visible.
        visibility: how surely each reference shows the target's surface, in [0, 1].
        names: names of the references.
        renders: the splat's renders of the references' views on the target's grid; None unless all are known.
        fine: the references on a grid 4 times as fine, in half precision to save memory where they are warped; None
            unless all have fine photos.
    """

    references: Float[Tensor, "r 3 h w"]
    visibility: Float[Tensor, "r 1 h w"]
    names: tuple[str, ...]
    renders: Float[Tensor, "r 3 h w"] | None = None
    fine: Float[Tensor, "r 3 H W"] | None = None


@runtime_checkable
class Warp(Protocol):
    """A method that aligns references to the target's grid."""

    def __call__(self, target: LoadedView, references: Sequence[LoadedView], keep: int) -> AlignedReferences:
        """Align at most ``keep`` of the references to the target's grid. References are ordered nearest first."""
        ...


@dataclass(frozen=True)
class Unwarped:
    """No warp: references are resized to the target's size and count as visible everywhere, as in the paper.

    Half-precision images are resized in single precision.
    """

    def __call__(self, target: LoadedView, references: Sequence[LoadedView], keep: int) -> AlignedReferences:
        """Resize the first ``keep`` references."""
        height, width = target.image.shape[-2:]
        nearest = [reference.to_single_precision() for reference in references[:keep]]
        warped = []
        for reference in nearest:
            image = resize(reference.image, height, width)
            render = None if reference.render is None else resize(reference.render, height, width)
            warped.append(Warped(image, torch.ones_like(image[:1]), render))
        photos = [read_photo().to(target.image.device) / 255 for read_photo in _fine_photo_readers(nearest)]
        fine = torch.stack([resize(photo, 4 * height, 4 * width) for photo in photos]) if photos else None
        return _stack_aligned(target, warped, [reference.name for reference in nearest], fine)


@dataclass(frozen=True)
class Reprojected:
    """Warp through the target's depth, match colours to the render, and rank references by what they show.

    If the splat's render of a reference's view is known, it is used to refine depth and to match colours: two renders
    of one splat do not differ in exposure or blur, and photo and render of one view share a pixel grid. Half precision
    cannot represent pixel coordinates, so half-precision views are warped in single precision, with autocast disabled.
    Where the splat is transparent, a dark reference may show a dark surface (`mark_dark_pixels_visible`).

    Args:
        depth: kind of the target's depth; it determines how far depth is refined photometrically before the warp
            (`refine_depth`).
        match_colour: match each reference's exposure to the splat's (`fit_colour`).
        tolerance: relative depth difference that the occlusion check tolerates (`reproject`).
        softness: mean colour difference, in [0, 1], at which a reference's weight at a pixel falls to 1/e in ranking.
        photo_consistency: mean colour difference to the render over 7x7 pixels, in [0, 1], above which a reference is
            treated as not visible. This rejects view-dependent reflections, such as the sky in glass, and errors that
            the depth check missed. Outliers among the references are treated alike (`hide_inconsistent`). None disables
            both checks.
        smooth: fit planes to the depth before each depth search (`smooth_depth`).
        consistent: in the depth search, also compare photos with each other, not only renders with the target's render.
        interpolation: interpolation of photos and renders between pixels; "bicubic" keeps detail that "bilinear"
            blurs (0.27 dB of a warped photo's error, measured on a converged fit).
    """

    depth: DepthKind = "surface"
    match_colour: bool = True
    tolerance: float = 0.05
    softness: float = 0.08
    photo_consistency: float | None = 0.2
    smooth: bool = True
    consistent: bool = True
    interpolation: Interpolation = "bilinear"

    def __post_init__(self) -> None:
        if self.depth not in SEARCHES:
            raise ValueError(f"depth is {self.depth!r}, none of {', '.join(SEARCHES)}")
        if self.interpolation not in get_args(Interpolation):
            raise ValueError(f"interpolation is {self.interpolation!r}, none of {', '.join(get_args(Interpolation))}")
        for name, value in (("tolerance", self.tolerance), ("softness", self.softness)):
            if not (isinstance(value, int | float) and value > 0):
                raise ValueError(f"{name} is {value!r}, no number above 0")
        limit = self.photo_consistency
        if not (limit is None or (isinstance(limit, int | float) and limit >= 0)):
            raise ValueError(f"photo_consistency is {limit!r}, neither null nor a number from 0 on")

    def __call__(self, target: LoadedView, references: Sequence[LoadedView], keep: int) -> AlignedReferences:
        """Warp all references and keep those that together show most. The depth search is not differentiable.

        Raises:
            InputError: a view has no camera, or the target has no depth.
        """
        with torch.autocast(target.image.device.type, enabled=False):
            return self._warp(
                target.to_single_precision(), [reference.to_single_precision() for reference in references], keep
            )

    def _warp(self, target: LoadedView, references: Sequence[LoadedView], keep: int) -> AlignedReferences:
        if not references or keep == 0:
            return _stack_aligned(target, [], [])
        if target.depth is None:
            raise InputError(
                target.name, "has no depth to reproject references through", "give depth, or alignment=none"
            )
        camera, cameras = _camera_of(target), [_camera_of(reference) for reference in references]
        exposures = [reference.exposure if self.match_colour else None for reference in references]
        pairs = zip(references, exposures, strict=True)
        photos = [view.image if exposure is None else apply_colour(view.image, exposure) for view, exposure in pairs]
        renders = [reference.render for reference in references]
        sources = [Source(*source) for source in zip(cameras, photos, renders, strict=True)]
        with torch.no_grad():
            search_options = self.depth, self.smooth, self.consistent
            depth = refine_depth(camera, target.depth, target.image, sources, *search_options)
        rendered = target.depth
        if target.alpha is not None:  # alpha marks the holes, so they can be filled here once for all references
            depth, rendered = fill_depth(depth), fill_depth(rendered)
        dark = dark_transparent_pixels(target.image, target.alpha)
        warped, differences = [], []
        for i, (source_camera, reference, photo) in enumerate(zip(cameras, references, photos, strict=True)):
            warp_options = reference.depth, target.alpha, self.tolerance, rendered, reference.render, self.interpolation
            view = reproject(camera, depth, source_camera, photo, *warp_options)
            if self.match_colour and exposures[i] is None:
                exposures[i] = exposure = fit_colour(view.colour, target.image, view.visibility)
                view = replace(view, colour=apply_colour(view.colour, exposure) * (view.visibility > 0))
            warped.append(view)
            differences.append(photometric_difference(view, target.image))
        if self.photo_consistency is not None:
            warped = hide_inconsistent(warped, differences, self.photo_consistency)
        if dark is not None:
            warped = [
                mark_dark_pixels_visible(view, dark, target.image, depth, (camera, other), photo, reference.render)
                for view, other, photo, reference in zip(warped, cameras, photos, references, strict=True)
            ]
        weights = [reference_weight(*pair, self.softness) for pair in zip(warped, differences, strict=True)]
        order = rank_references(weights, keep)
        readers, fine = _fine_photo_readers([references[i] for i in order]), None
        if readers:
            sides = (4 * side for side in target.image.shape[-2:])
            fine = target.image.new_empty(len(order), 3, *sides, dtype=torch.float16)
            for i, read_photo, result in zip(order, readers, fine, strict=True):
                photo = read_photo().to(target.image.device)
                _warp_fine_photo(camera, depth, cameras[i], photo, exposures[i], warped[i], result)
        return _stack_aligned(target, [warped[i] for i in order], [references[i].name for i in order], fine)


def _fine_photo_readers(references: Sequence[LoadedView]) -> list[Callable[[], UInt8[Tensor, "3 _ _"]]]:
    """Readers of the references' fine photos; empty unless every reference has one."""
    reads = [reference.read_fine for reference in references if reference.read_fine is not None]
    return reads if len(reads) == len(references) else []


def _warp_fine_photo(
    camera: Camera,
    depth: Float[Tensor, "1 h w"],
    reference_camera: Camera,
    photo: UInt8[Tensor, "3 _ _"],
    exposure: Float[Tensor, "3 2"] | None,
    warped: Warped,
    result: Float16[Tensor, "3 H W"],
) -> None:
    """Warp a reference's fine photo to a grid 4 times as fine as the target's, with the visibility of the coarse warp.

    Args:
        camera: camera of the target.
        depth: refined depth of the target at its own size. It is upsampled as inverse depth, which is linear on planes.
        reference_camera: camera of the reference.
        photo: fine photo of the reference.
        exposure: gain and offset that were applied to the warped reference.
        warped: the reference on the target's grid.
        result: output, written in place.
    """
    height, width = result.shape[-2:]
    transform = torch.tensor([[1 / 255, 0.0]]).expand(3, 2)
    if exposure is not None:  # applied after sampling, which avoids a copy of the photo
        transform = exposure * exposure.new_tensor([1 / 255, 1.0])
    transform = transform.to(depth)
    fine_camera = camera.resized(height, width)
    filled = fill_depth(depth)
    footprint = footprint_between(camera, filled, reference_camera.resized(*photo.shape[-2:])) / 4
    inverse_depth = F.interpolate(1 / filled[None], size=(height, width), mode="bilinear", align_corners=False)[0]
    for top in range(0, height, STRIP):
        rows = slice(top, min(top + STRIP, height))
        coarse_rows = slice(top // 4, -(-rows.stop // 4))
        visibility = F.interpolate(warped.visibility[None, :, coarse_rows], scale_factor=4)[0]
        strip = fine_camera.crop(Region(top, 0, rows.stop, width))
        strip_samples = reproject(
            strip, 1 / inverse_depth[:, rows], reference_camera, photo, alpha=visibility, footprint=footprint
        )
        result[:, rows] = _fine_rows(strip_samples, transform, warped.colour, top)


def _fine_rows(
    samples: Warped, transform: Float[Tensor, "3 2"], coarse: Float[Tensor, "3 h w"], top: int
) -> Float[Tensor, "3 s W"]:
    """Rows of a fine reference, with colours of the coarse reference where only that one is visible.

    At the photo's border, a pixel may be visible on the coarse grid but not on the fine one.

    Args:
        samples: the sampled rows, before gain and offset.
        transform: gain and offset from 8-bit colours to [0, 1] in the render's exposure.
        coarse: the reference on the target's grid.
        top: index of the first row.
    """
    if can_use_kernels(samples.colour, samples.visibility, coarse):
        from gaussian_enhancer.align.reproject_kernels import finish_fine
        from gaussian_enhancer.compiled import kernel_lock

        inputs, result = (samples.colour, samples.visibility[0], transform, coarse), torch.empty_like(samples.colour)
        with kernel_lock:
            finish_fine(*map(numpy_view, inputs), top, result.numpy())
        return result
    bottom = top + samples.colour.shape[-2]
    coarse_colour = F.interpolate(coarse[None, :, top // 4 : -(-bottom // 4)], scale_factor=4)[0]
    return torch.where(samples.visibility > 0, apply_colour(samples.colour, transform), coarse_colour)


def _camera_of(view: LoadedView) -> Camera:
    if view.camera is None:
        raise InputError(view.name, "has no camera to reproject with", "give cameras, or alignment=none")
    return view.camera


def _stack_aligned(
    target: LoadedView, warped: Sequence[Warped], names: Sequence[str], fine: Float[Tensor, "r 3 H W"] | None = None
) -> AlignedReferences:
    height, width = target.image.shape[-2:]
    if not warped:
        empty = target.image.new_zeros(0, 4, height, width)
        return AlignedReferences(empty[:, :3], empty[:, 3:], ())
    renders = [view.render for view in warped if view.render is not None]
    return AlignedReferences(
        torch.stack([view.colour for view in warped]),
        torch.stack([view.visibility for view in warped]),
        tuple(names),
        torch.stack(renders) if len(renders) == len(warped) else None,
        fine,
    )
