"""Photos at 4 times the resolution of a fitted run's renders, from the scene that the run's configuration names.

Axes: h height, w width.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from jaxtyping import Float
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import read_configuration
from gaussian_enhancer.runs.instantiate import plain_values
from gaussian_enhancer.runs.run import digest_of
from gaussian_enhancer.scene.high_resolution import UPSCALE, attach_fine_photos
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.photos import read_header, read_photo
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.scene import Scene

PROCEDURAL = "gaussian_enhancer.scene.procedural."


class HighResolutionPhotos:
    """Attaches photos at 4 times the render's resolution to the views of fitted runs.

    Args:
        folder: cache of the rendered photos of procedural scenes, since each takes seconds to render.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __call__(self, run: Path, rendered: RenderedSet) -> RenderedSet:
        """Attach ``read_fine_photo`` to all views.

        Args:
            run: folder of the run.
            rendered: views of the run.

        Raises:
            InputError: the run names no scene, or the scene's photos are not available at 4 times the renders' size.
        """
        # Imported here because it loads the procedural scenes, which jobs without finer photos do not need.
        from gaussian_enhancer.scene.stored import read_scene_values, scene_from_values

        run = _fit_of(run)
        fine_scene = high_resolution_values(read_scene_values(run / "config.yaml"))
        if not _is_procedural(fine_scene):
            return attach_fine_photos(rendered, scene_from_values(fine_scene))
        folder = self.folder / f"{run.name.split('-')[0]}-{digest_of(fine_scene)}"
        return _render_fine(rendered, cache(lambda: scene_from_values(fine_scene)), folder)


def _fit_of(run: Path) -> Path:
    """The run whose configuration names the scene: the run itself, or the fit from which it was distilled.

    Raises:
        InputError: a configuration cannot be read.
    """
    seen = set[Path]()
    while run not in seen and (run / "config.yaml").is_file():
        seen.add(run)
        values = read_configuration(run / "config.yaml")
        if "scene" not in values and isinstance(values.get("run"), str):
            run = Path(values["run"])
    return run


def high_resolution_config(scene: DictConfig) -> DictConfig:
    """The configuration of a scene with photos at 4 times the resolution.

    Args:
        scene: configuration of a procedural scene or of a capture.

    Raises:
        InputError: the stored photos are not that large.
    """
    return OmegaConf.create(high_resolution_values(plain_values(scene)))


def high_resolution_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """The plain values of a scene's configuration, changed to photos at 4 times the resolution.

    Args:
        values: configuration of a procedural scene or of a capture.

    Raises:
        InputError: the stored photos are not that large, or a size is not a number.
    """
    if _is_procedural(values):
        size = {"height": UPSCALE * _number(values, "height", 192), "width": UPSCALE * _number(values, "width", 256)}
        return {**values, **size, "points": 0}
    downscale = _number(values, "downscale", 1) / UPSCALE
    if downscale < 1:
        received = f"is rendered at 1/{values.get('downscale', 1)} of its photos' size"
        subject = values.get("path", values.get("_target_"))
        raise InputError(
            subject,
            received,
            f"fit it with scene.downscale={UPSCALE} or more, so that photos of 4 times the resolution exist",
        )
    return {**values, "downscale": int(downscale) if downscale == int(downscale) else downscale}


def _number(values: Mapping[str, Any], name: str, default: int) -> int | float:
    value = values.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"scene.{name}", f"is {value!r}", "give a number")
    return value


def _is_procedural(values: Mapping[str, Any]) -> bool:
    return str(values.get("_target_")).startswith(PROCEDURAL)


def _render_fine(rendered: RenderedSet, scene: Callable[[], Scene], folder: Path) -> RenderedSet:
    def attach(view: RenderedView) -> RenderedView:
        if view.camera is None:
            raise InputError(view.name, "has no camera", "give the run as `fit` wrote it")
        stem = Path(view.name).stem
        size = UPSCALE * view.camera.height, UPSCALE * view.camera.width
        return replace(view, read_fine_photo=ReadProceduralPhoto(scene, stem, folder / f"{stem}.png", *size))

    return replace(
        rendered, targets=tuple(map(attach, rendered.targets)), references=tuple(map(attach, rendered.references))
    )


@dataclass(frozen=True)
class ReadProceduralPhoto:
    """Reads a photo of a procedural scene from its file; a missing file is rendered first.

    Args:
        scene: returns the scene; called only if the photo has to be rendered.
        stem: the photo's name without its extension.
        path: file of the photo.
        height: height in pixels.
        width: width in pixels.
    """

    scene: Callable[[], Scene]
    stem: str
    path: Path
    height: int
    width: int

    def __call__(self) -> Float[Tensor, "3 h w"]:
        """The photo, shape (3, height, width), [0, 1].

        Raises:
            InputError: the scene has no photo of this name, or its size differs.
        """
        if not self.path.is_file():
            photos = {Path(photo.name).stem: photo for photo in self.scene().photos}
            if self.stem not in photos:
                raise InputError(self.path, "belongs to no photo of its scene", "give the run as `fit` wrote it")
            write_image(self.path, photos[self.stem].read())
        header = read_header(self.path)
        if (header.height, header.width) != (self.height, self.width):
            received = f"is {header.width}x{header.height} where {self.width}x{self.height} is expected"
            raise InputError(self.path, received, "delete the folder; its photos are rendered again")
        return read_photo(self.path)
