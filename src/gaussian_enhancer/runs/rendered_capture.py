"""Renders the views of a capture or of a camera path from a splat.

Axes: h height, w width.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.splat.methods import Method
from gaussian_enhancer.types import Camera, Gaussians, Render, quantise_8_bit


@dataclass(frozen=True)
class SplatRenderer:
    """Renders a splat.

    Args:
        gaussians: the splat, on the device that renders it.
        method: rendering method.
        background: background colour.
        near: near plane: smallest rendered z in scene units.
    """

    gaussians: Gaussians
    method: Method
    background: tuple[float, float, float]
    near: float

    def __call__(self, camera: Camera) -> Render:
        """Render one view and move the result to the CPU."""
        from gaussian_enhancer.splat.render import render

        on_device = camera.to(self.gaussians.means.device)
        with torch.no_grad():
            return render(self.gaussians, on_device, self.method, self.background, near=self.near).to("cpu")

    def sees(self, camera: Camera) -> bool:
        """Whether the centre of a Gaussian lies in a camera's image."""
        from gaussian_enhancer.splat.fit.geometry import seen_from

        depth, inside = seen_from(camera.to(self.gaussians.means), self.gaussians.means)
        return bool((inside & (depth > self.near)).any())

    def target(self, name: str, camera: Camera | None, photo: Photo | None = None) -> RenderedView:
        """Create a target whose render is computed when it is read.

        Args:
            name: file name of the target.
            camera: camera of the render.
            photo: photo of the same view, if there is one.

        Raises:
            InputError: the camera is None.
        """
        render = self._lazy_render(name, camera, ("colour", "surface", "alpha"))
        read_photo = None if photo is None else photo.read
        return RenderedView(name, render.colour, camera, render.depth, render.alpha, read_photo)

    def reference(self, photo: Photo) -> RenderedView:
        """Create a reference from a photo, with the splat's render of the same view.

        Args:
            photo: a photo with its camera.

        Raises:
            InputError: the photo has no camera.
        """
        render = self._lazy_render(photo.name, photo.camera, ("colour", "surface"))
        return RenderedView(png_name(photo.name), render.colour, photo.camera, render.depth, None, photo.read)

    def _lazy_render(self, name: str, camera: Camera | None, planes: tuple[str, ...]) -> "_LazyRender":
        if camera is None:
            raise InputError(name, "has no camera to render from", "give a capture with cameras")
        return _LazyRender(lambda: self(camera), planes)


def open_renderer(
    file: str | Path,
    cameras: Sequence[Camera],
    background: tuple[float, float, float],
    method: str = "auto",
    device: str = "cpu",
    invalid: str = "refuse",
) -> SplatRenderer:
    """Read a splat and prepare its rendering.

    Args:
        file: the splat.
        cameras: cameras of the capture that the splat was fitted to; the near plane is derived from their extent.
        background: background colour.
        method: rendering method (`choose_method`).
        device: device of the rendering.
        invalid: treatment of Gaussians that are not finite: "refuse" or "drop".

    Raises:
        InputError: the splat cannot be read or is not in the coordinates of its capture, or the method is unknown.
    """
    from gaussian_enhancer.splat.io.gsplat_results import refuse_normalised
    from gaussian_enhancer.splat.io.open import read_splat
    from gaussian_enhancer.splat.methods import choose_method
    from gaussian_enhancer.splat.near import near_plane

    refuse_normalised(file)
    gaussians = read_splat(file, invalid=invalid).to(device)
    return SplatRenderer(gaussians, choose_method(method, gaussians), background, near_plane(cameras))


def refuse_unseen(renderer: SplatRenderer, cameras: Iterable[Camera], file: object, views: str) -> None:
    """Refuse a splat that lies outside the views of its capture, whose renders would be empty.

    Args:
        renderer: renderer of the splat.
        cameras: cameras of the views.
        file: the splat, named in the error.
        views: the views, named in the error.

    Raises:
        InputError: no camera sees a Gaussian.
    """
    if not any(map(renderer.sees, cameras)):
        remedy = "give the splat in the coordinates of its capture, as it was fitted: neither moved nor scaled"
        raise InputError(file, f"has no Gaussian in any view of {views}", remedy)


def render_capture(
    file: str | Path, capture: Scene, method: str, views: str, device: str = "cpu", invalid: str = "refuse"
) -> RenderedSet:
    """The views of a capture; each is rendered from the splat when it is read.

    Args:
        file: the splat.
        capture: scene with cameras and reference photos.
        method: rendering method (`choose_method`).
        views: views that become targets: "test", "train" or "all".
        device: device of the rendering.
        invalid: treatment of Gaussians that are not finite: "refuse" or "drop".

    Raises:
        InputError: the splat cannot be read, the method or ``views`` is unknown, no view of that choice exists, or none
            of them shows a Gaussian.
    """
    renderer = open_renderer(file, capture.train_cameras, capture.background, method, device, invalid)
    photos = {"test": capture.test_photos, "train": capture.train_photos, "all": capture.photos}
    if views not in photos:
        raise InputError("views", f"is {views!r}", f"choose {', '.join(photos)}")
    if not photos[views]:
        raise InputError(capture.name, f"has no {views} view", "change the split, or views=all")
    targets = tuple(renderer.target(png_name(photo.name), photo.camera, photo) for photo in photos[views])
    target_cameras = [target.camera for target in targets if target.camera is not None]
    refuse_unseen(renderer, target_cameras, file, f"{capture.name} that is to be enhanced")
    references = tuple(map(renderer.reference, capture.train_photos))
    return RenderedSet(capture.name, targets, references, capture.background, own_depth=True)


def png_name(name: str) -> str:
    """The file name of a photo's render; a target and the photo of the same view share it.

    Args:
        name: file name of the photo.
    """
    return str(Path(name).with_suffix(".png"))


class _LazyRender:
    """One render whose colour, depth and opacity are read separately; each is freed once it is read."""

    def __init__(self, draw: Callable[[], Render], plane_names: tuple[str, ...]) -> None:
        self.draw, self.plane_names = draw, plane_names
        self.planes: dict[str, Tensor] = {}

    def colour(self) -> Float[Tensor, "3 h w"]:
        """The render, rounded to 8 bits like a file of a folder of renders."""
        return quantise_8_bit(self._pop("colour"))

    def depth(self) -> Float[Tensor, "1 h w"]:
        """Surface depth."""
        return self._pop("surface")

    def alpha(self) -> Float[Tensor, "1 h w"]:
        """Opacity."""
        return self._pop("alpha")

    def _pop(self, name: str) -> Tensor:
        if name not in self.planes:
            render = self.draw()
            self.planes = {plane: getattr(render, plane) for plane in self.plane_names}
        return self.planes.pop(name)
