"""Alignment of references to the target's pixel grid.

Axes: r references, h height, w width of the target, H = 4 h, W = 4 w.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Protocol, get_args, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Float, UInt8
from torch import Tensor

from gaussian_enhancer.align.depth_search import SEARCHES, DepthKind, Source, refine_depth
from gaussian_enhancer.align.exposure import apply_colour, fit_colour, fit_exposure
from gaussian_enhancer.align.photo_consistency import hide_inconsistent, photometric_difference, rank, reference_weight
from gaussian_enhancer.align.projection import Interpolation, can_use_kernels, kernel_image
from gaussian_enhancer.align.reproject import Warped, fill_depth, footprint_between, reproject
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.photos import resize
from gaussian_enhancer.types import Camera, Region, single_precision

NOT_IMAGES = "name", "camera", "read_fine"
"""Fields of `Pixels` that hold no image."""
STRIP = 256
"""Rows of a fine grid that are warped at once, so that large images need little memory."""


@dataclass(frozen=True)
class Pixels:
    """A view in memory: a target's render, or a reference's photo.

    Args:
        name: the view's file name.
        image: colours in [0, 1].
        camera: where it was taken from, of the image's size; None where unknown.
        depth: rendered z, scene units, 0 where nothing was hit, for references of any size; None where unknown.
        alpha: rendered opacity; None where unknown.
        render: the splat's own render of a reference's view, of any size; None where unknown.
        read_fine: reads a reference's 8-bit photo on a finer grid, of any size; None where not asked for.
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

    def to_device(self, device: torch.device) -> "Pixels":
        """The view with its images on a device; its camera, of which a few numbers are read, stays."""
        return self._map_images(lambda image: image.to(device))

    def to_single_precision(self) -> "Pixels":
        """The view with its images in single precision where they were in half."""
        return self._map_images(single_precision)

    def _map_images(self, change: Callable[[Tensor], Tensor]) -> "Pixels":
        """The view with its images changed; the same object, with its cached values, if no image changes."""
        images = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in NOT_IMAGES}
        changed = {name: change(image) for name, image in images.items() if image is not None}
        if all(image is images[name] for name, image in changed.items()):
            return self
        return replace(self, **changed)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Aligned:
    """References on the target's grid, the most useful first.

    Args:
        references: colours, 0 where nothing is visible.
        visibility: how surely each shows the target's surface, in [0, 1].
        names: of the references.
        renders: the splat's own renders of the references' views on the target's grid; None unless all are known.
        fine: the references on a grid 4 times as fine; None unless all are known.
    """

    references: Float[Tensor, "r 3 h w"]
    visibility: Float[Tensor, "r 1 h w"]
    names: tuple[str, ...]
    renders: Float[Tensor, "r 3 h w"] | None = None
    fine: Float[Tensor, "r 3 H W"] | None = None


@runtime_checkable
class Warp(Protocol):
    """A method of bringing references to the target's grid."""

    def __call__(self, target: Pixels, references: Sequence[Pixels], keep: int) -> Aligned:
        """Bring at most ``keep`` of the references, given nearest first, to the target's grid."""
        ...


@dataclass(frozen=True)
class Unwarped:
    """No warp: references are only resized to the target's size and count as visible everywhere, as in the paper.

    Half precision is resized in single.
    """

    def __call__(self, target: Pixels, references: Sequence[Pixels], keep: int) -> Aligned:
        """Take the first ``keep`` references."""
        height, width = target.image.shape[-2:]
        chosen = [reference.to_single_precision() for reference in references[:keep]]
        warped = []
        for reference in chosen:
            image = resize(reference.image, height, width)
            render = None if reference.render is None else resize(reference.render, height, width)
            warped.append(Warped(image, torch.ones_like(image[:1]), render))
        photos = [read_photo().to(target.image.device) / 255 for read_photo in _fine_reads(chosen)]
        fine = torch.stack([resize(photo, 4 * height, 4 * width) for photo in photos]) if photos else None
        return _stack_aligned(target, warped, [reference.name for reference in chosen], fine)


@dataclass(frozen=True)
class Reprojected:
    """Warp through the target's depth, match colours to the render, and rank references by what they show.

    Where the splat's own render of a reference's view is known, depth is refined and colours are matched by it: what
    one splat renders twice differs in neither exposure nor blur, and photo and render of one view lie on one grid.
    Half precision cannot address pixels: views in it are warped in single precision, and autocast stays outside.

    Args:
        depth: what the target's depth is; says how far it is bettered photometrically before the warp (`refine_depth`).
        match_colour: bring each reference's exposure to the splat's (`fit_colour`).
        tolerance: relative depth difference that the occlusion check forgives (`reproject`).
        softness: mean colour difference, in [0, 1], at which a reference's worth at a pixel falls to 1/e in ranking.
        photo_consistency: mean colour difference to the render over 7x7 pixels, in [0, 1], beyond which a reference
            does not count as showing the same: glass that mirrors the sky from one place and not from another, or what
            the depth check missed. None leaves that unchecked.
        smooth: fit planes to depth that is the splat's surface before it is searched (`smooth_depth`).
        consistent: where that is searched, ask photos to agree with each other, not only renders with the target's.
        interpolation: how photos and renders are read between their pixels; "bicubic" keeps detail that "bilinear"
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

    def __call__(self, target: Pixels, references: Sequence[Pixels], keep: int) -> Aligned:
        """Warp all references and keep those that together show most; no gradient passes through the search of depth.

        Raises:
            InputError: a view has no camera, or the target no depth.
        """
        with torch.autocast(target.image.device.type, enabled=False):
            return self._warp(
                target.to_single_precision(), [reference.to_single_precision() for reference in references], keep
            )

    def _warp(self, target: Pixels, references: Sequence[Pixels], keep: int) -> Aligned:
        if not references or keep == 0:
            return _stack_aligned(target, [], [])
        if target.depth is None:
            raise InputError(
                target.name, "has no depth to reproject references through", "give depth, or alignment=none"
            )
        camera, cameras = _camera_of(target), [_camera_of(reference) for reference in references]
        exposures = [reference.exposure if self.match_colour else None for reference in references]
        pairs = zip(references, exposures, strict=True)
        photos = [one.image if exposure is None else apply_colour(one.image, exposure) for one, exposure in pairs]
        renders = [reference.render for reference in references]
        sources = [Source(*source) for source in zip(cameras, photos, renders, strict=True)]
        with torch.no_grad():
            search_options = self.depth, self.smooth, self.consistent
            depth = refine_depth(camera, target.depth, target.image, sources, *search_options)
        rendered = target.depth
        if target.alpha is not None:  # says where holes are; they are filled once for all references
            depth, rendered = fill_depth(depth), fill_depth(rendered)
        warped, worth = [], []
        for i, (other, reference, photo) in enumerate(zip(cameras, references, photos, strict=True)):
            warp_options = reference.depth, target.alpha, self.tolerance, rendered, reference.render, self.interpolation
            one = reproject(camera, depth, other, photo, *warp_options)
            if self.match_colour and exposures[i] is None:
                exposures[i] = exposure = fit_colour(one.colour, target.image, one.visibility)
                one = replace(one, colour=apply_colour(one.colour, exposure) * (one.visibility > 0))
            difference = photometric_difference(one, target.image)
            if self.photo_consistency is not None:
                one = hide_inconsistent(one, difference, self.photo_consistency)
            warped.append(one)
            worth.append(reference_weight(one, difference, self.softness))
        order = rank(worth, keep)
        reads, fine = _fine_reads([references[i] for i in order]), None
        if reads:
            fine = target.image.new_empty(len(order), 3, *(4 * side for side in target.image.shape[-2:]))
            for i, read_photo, result in zip(order, reads, fine, strict=True):
                photo = read_photo().to(target.image.device)
                _warp_finely(camera, depth, cameras[i], photo, exposures[i], warped[i], result)
        return _stack_aligned(target, [warped[i] for i in order], [references[i].name for i in order], fine)


def _fine_reads(references: Sequence[Pixels]) -> list[Callable[[], UInt8[Tensor, "3 _ _"]]]:
    """Readers of the references' fine photos; none unless all have one."""
    reads = [reference.read_fine for reference in references if reference.read_fine is not None]
    return reads if len(reads) == len(references) else []


def _warp_finely(
    camera: Camera,
    depth: Float[Tensor, "1 h w"],
    other: Camera,
    photo: UInt8[Tensor, "3 _ _"],
    exposure: Float[Tensor, "3 2"] | None,
    warped: Warped,
    result: Float[Tensor, "3 H W"],
) -> None:
    """Write the reference's fine photo on a grid 4 times as fine as the target's, with the warp's visibility.

    Args:
        camera: the target's.
        depth: the target's, refined, at its own size; enlarged as inverse depth, in which planes are linear.
        other: the reference's camera.
        photo: the reference's fine photo.
        exposure: gain and offset that were applied to the warped reference.
        warped: the reference on the target's own grid.
        result: is written.
    """
    height, width = result.shape[-2:]
    colours = torch.tensor([[1 / 255, 0.0]]).expand(3, 2)
    if exposure is not None:  # of what was read, so that no copy of the photo is made
        colours = exposure * exposure.new_tensor([1 / 255, 1.0])
    colours = colours.to(result)
    fine = camera.resized(height, width)
    filled = fill_depth(depth)
    step = footprint_between(camera, filled, other.resized(*photo.shape[-2:])) / 4
    inverse = F.interpolate(1 / filled[None], size=(height, width), mode="bilinear", align_corners=False)[0]
    for top in range(0, height, STRIP):
        rows = slice(top, min(top + STRIP, height))
        coarse = slice(top // 4, -(-rows.stop // 4))
        visibility = F.interpolate(warped.visibility[None, :, coarse], scale_factor=4)[0]
        strip = fine.cut(Region(top, 0, rows.stop, width))
        finely = reproject(strip, 1 / inverse[:, rows], other, photo, alpha=visibility, footprint=step)
        _write_fine_rows(finely, colours, warped.colour, top, result)


def _write_fine_rows(
    finely: Warped,
    colours: Float[Tensor, "3 2"],
    coarse: Float[Tensor, "3 h w"],
    top: int,
    result: Float[Tensor, "3 H W"],
) -> None:
    """Write rows of a fine reference: its own colours, and those of the coarse reference where only that is visible.

    At the photo's border the coarse grid may see what the fine one does not.

    Args:
        finely: the rows, as they were read.
        colours: gain and offset that bring them to [0, 1] and to the render's exposure.
        coarse: the reference on the target's own grid.
        top: the first of the rows.
        result: is written.
    """
    if can_use_kernels(finely.colour, finely.visibility, coarse, result):
        from gaussian_enhancer.align.reproject_kernels import finish_fine
        from gaussian_enhancer.splat.compiled import kernel_lock

        inputs = finely.colour, finely.visibility[0], colours, coarse
        with kernel_lock:
            finish_fine(*map(kernel_image, inputs), top, result.numpy())
        return
    bottom = top + finely.colour.shape[-2]
    colour = F.interpolate(coarse[None, :, top // 4 : -(-bottom // 4)], scale_factor=4)[0]
    result[:, top:bottom] = torch.where(finely.visibility > 0, apply_colour(finely.colour, colours), colour)


def _camera_of(view: Pixels) -> Camera:
    if view.camera is None:
        raise InputError(view.name, "has no camera to reproject with", "give cameras, or alignment=none")
    return view.camera


def _stack_aligned(
    target: Pixels, warped: Sequence[Warped], names: Sequence[str], fine: Float[Tensor, "r 3 H W"] | None = None
) -> Aligned:
    height, width = target.image.shape[-2:]
    if not warped:
        empty = target.image.new_zeros(0, 4, height, width)
        return Aligned(empty[:, :3], empty[:, 3:], ())
    renders = [one.render for one in warped if one.render is not None]
    return Aligned(
        torch.stack([one.colour for one in warped]),
        torch.stack([one.visibility for one in warped]),
        tuple(names),
        torch.stack(renders) if len(renders) == len(warped) else None,
        fine,
    )
