"""Rendering the views of a capture from a splat.

Axes: h height, w width.
"""

from collections.abc import Callable
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.types import Render


def render_capture(
    file: str | Path, capture: Scene, method: str, views: str, device: str = "cpu", invalid: str = "refuse"
) -> RenderedSet:
    """The views of a capture, rendered from a splat when they are read.

    Args:
        file: the splat.
        capture: cameras and reference photos.
        method: how the splat is rendered (`choose_method`).
        views: "test", "train" or "all".
        device: where to render.
        invalid: what to do with Gaussians that are not finite: "refuse" or "drop".

    Raises:
        InputError: the splat cannot be read, the method or the choice of views is unknown, or no view remains.
    """
    from gaussian_enhancer.splat.io.open import read_splat
    from gaussian_enhancer.splat.methods import choose_method
    from gaussian_enhancer.splat.near import near_plane
    from gaussian_enhancer.splat.render import render

    gaussians = read_splat(file, invalid=invalid).to(device)
    chosen = choose_method(method, gaussians)
    sides = {"test": capture.test_photos, "train": capture.train_photos, "all": capture.photos}
    if views not in sides:
        raise InputError("views", f"is {views!r}", f"choose {', '.join(sides)}")
    if not sides[views]:
        raise InputError(capture.name, f"has no {views} view", "change the split, or views=all")

    near = near_plane([photo.camera for photo in capture.train_photos if photo.camera is not None])

    def lossless(photo: Photo) -> str:
        """The photo's name as a render is stored; a target and the photo of the same view share it."""
        return str(Path(photo.name).with_suffix(".png"))

    def drawn(photo: Photo, parts: tuple[str, ...]) -> _Drawing:
        if photo.camera is None:
            raise InputError(photo.name, "has no camera to render from", "give a capture with cameras")
        camera = photo.camera.to(device)
        return _Drawing(lambda: render(gaussians, camera, chosen, capture.background, near=near).to("cpu"), parts)

    def target(photo: Photo) -> RenderedView:
        draw = drawn(photo, ("colour", "surface", "alpha"))
        return RenderedView(lossless(photo), draw.colour, photo.camera, draw.depth, draw.alpha, photo.read)

    def reference(photo: Photo) -> RenderedView:
        draw = drawn(photo, ("colour", "surface"))
        return RenderedView(lossless(photo), draw.colour, photo.camera, draw.depth, None, photo.read)

    targets, references = map(target, sides[views]), map(reference, capture.train_photos)
    return RenderedSet(capture.name, tuple(targets), tuple(references), capture.background, own_depth=True)


class _Drawing:
    """One rendering that serves the readers of its colour, depth and opacity; each part is dropped once it is read."""

    def __init__(self, draw: Callable[[], Render], wanted: tuple[str, ...]) -> None:
        self.draw, self.wanted = draw, wanted
        self.parts: dict[str, Tensor] = {}

    def colour(self) -> Float[Tensor, "3 h w"]:
        """The render, rounded to 8 bits as in a folder of renders."""
        return (self._part("colour").clamp(0, 1) * 255).round() / 255

    def depth(self) -> Float[Tensor, "1 h w"]:
        """Depth of the surface."""
        return self._part("surface")

    def alpha(self) -> Float[Tensor, "1 h w"]:
        """Opacity."""
        return self._part("alpha")

    def _part(self, name: str) -> Tensor:
        if name not in self.parts:
            with torch.no_grad():
                drawing = self.draw()
            self.parts = {part: getattr(drawing, part) for part in self.wanted}
        return self.parts.pop(name)
