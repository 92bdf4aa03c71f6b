"""High-resolution photos (4 times the renders) as targets and references of super-resolution.

Axes: h height, w width.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.photos import resize
from gaussian_enhancer.scene.posed import ReadPhoto
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.types import Camera

UPSCALE = 4
SLACK = 3
"""Tolerance in pixels between a fine photo's size and 4 times the render's, for rounding when both were downscaled."""


@dataclass(frozen=True)
class ReadResized:
    """Callable that reads a photo and resizes it."""

    read: Callable[[], Float[Tensor, "3 _ _"]]
    height: int
    width: int

    def __call__(self) -> Float[Tensor, "3 h w"]:
        """Read the photo, shape (3, height, width), [0, 1]."""
        return resize(self.read(), self.height, self.width)


def attach_fine_photos(rendered: RenderedSet, finer: Scene) -> RenderedSet:
    """Attach the photos of a finer scene to a set as ``read_fine_photo``, matched by name without ending.

    A photo whose size differs from 4 times the render's by rounding is resized to exactly 4 times the render's size. It
    shows the same field of view, since the render's camera was resized to the render's size in the same way.
    ``fine_size`` stores the photo's original size.

    Args:
        rendered: renders with their references.
        finer: the scene that was rendered, at 4 times the resolution.

    Raises:
        InputError: a view has no photo in the scene, or the photo has another size.
    """
    photos = {Path(photo.name).stem: photo for photo in finer.photos}

    def attach(view: RenderedView) -> RenderedView:
        photo = photos.get(Path(view.name).stem)
        if photo is None:
            raise InputError(finer.name, f"has no photo of {view.name}", "give the scene that was rendered")
        return _with_fine_photo(view, photo)

    targets, references = map(attach, rendered.targets), map(attach, rendered.references)
    return dataclasses.replace(rendered, targets=tuple(targets), references=tuple(references))


def is_finer(size: tuple[int, int], render: tuple[int, int]) -> bool:
    """Whether a height and width are 4 times those of a render, within `SLACK` pixels."""
    return all(abs(fine_side - UPSCALE * side) <= SLACK for fine_side, side in zip(size, render, strict=True))


def resized_reader(read: Callable[[], Float[Tensor, "3 _ _"]], height: int, width: int) -> Callable[[], Tensor]:
    """A reader of the same photo at another size. A `ReadPhoto` is changed to resample its file only once."""
    if isinstance(read, ReadPhoto):
        return dataclasses.replace(read, height=height, width=width)
    return ReadResized(read, height, width)


def original_size(size: tuple[int, int], render: tuple[int, int]) -> tuple[int, int] | None:
    """The size of a finer photo; None if it is exactly 4 times the render's."""
    return None if size == (UPSCALE * render[0], UPSCALE * render[1]) else size


def _with_fine_photo(view: RenderedView, photo: Photo) -> RenderedView:
    if view.read is None:
        return dataclasses.replace(view, read_fine_photo=photo.read)
    render_size, photo_size = _size(view.camera, view.read), _size(photo.camera, photo.read)
    if not is_finer(photo_size, render_size):
        height, width = (UPSCALE * side for side in render_size)
        received = f"is {photo_size[1]}x{photo_size[0]} where 4 times its render {view.name} is {width}x{height}"
        raise InputError(photo.name, received, "give photos of 4 times the renders' resolution")
    read = resized_reader(photo.read, UPSCALE * render_size[0], UPSCALE * render_size[1])
    return dataclasses.replace(view, read_fine_photo=read, fine_size=original_size(photo_size, render_size))


def _size(camera: Camera | None, read: Callable[[], Tensor]) -> tuple[int, int]:
    """Height and width of a view: its camera's or, without a camera, its image's."""
    height, width = read().shape[-2:] if camera is None else (camera.height, camera.width)
    return int(height), int(width)
