"""Views for measuring speed without data: a procedural scene at any size, in memory or as a run's folder.

The render is the photo at half of its resolution; depth is exact. Photos are drawn at most ``DRAWN`` pixels wide and
enlarged, since drawing takes 15 s a megapixel; times do not depend on their sharpness.
"""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.scene.cameras import Side, write_cameras
from gaussian_enhancer.scene.high_resolution import UPSCALE
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.in_memory import read_once
from gaussian_enhancer.scene.photos import resize
from gaussian_enhancer.scene.posed import ReadPhoto
from gaussian_enhancer.scene.procedural import procedural_scene
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.scene.scene import Scene

DRAWN = 504
REFERENCES = 5
STEP = 1
"""Training step that the folder's names state."""


def synthetic_views(height: int, width: int, family: str = "outdoor", finer: bool = False) -> RenderedSet:
    """One target and its nearest references, read once and kept in memory.

    Args:
        height: of the renders, in pixels.
        width: of the renders, in pixels.
        family: of the procedural scene.
        finer: add photos 4 times as fine, for super-resolution.

    Raises:
        InputError: the family is unknown.
    """
    scene = _scene(family, height, width)
    target = scene.test[len(scene.test) // 2]
    nearest = sorted(scene.train, key=lambda index: (abs(index - target), index))[:REFERENCES]
    views = [read_once(_view(scene, index, family, finer)) for index in (target, *nearest)]
    return RenderedSet(scene.name, (views[0],), tuple(views[1:]), own_depth=True)


def write_views(rendered: RenderedSet, folder: Path) -> None:
    """Write a set as a fitted run's folder; finer photos go into the folder ``fine``.

    Args:
        rendered: with renders, photos, depth and cameras.
        folder: of the files; created if it does not exist.

    Raises:
        InputError: a file cannot be written.
    """
    views: list[RenderedView] = [*rendered.targets, *rendered.references]
    sides: list[Side] = ["test"] * len(rendered.targets) + ["train"] * len(rendered.references)  # type: ignore[assignment]
    for view, side in zip(views, sides, strict=True):
        if view.read is None or view.read_photo is None or view.read_depth is None:
            raise ValueError(f"{view.name} lacks a render, a photo or depth")
        side_folder = folder / side / f"ours_{STEP}"
        for name in ("renders", "gt", "depth"):
            (side_folder / name).mkdir(parents=True, exist_ok=True)
        write_image(side_folder / "renders" / view.name, view.read())
        write_image(side_folder / "gt" / view.name, view.read_photo())
        np.save(side_folder / "depth" / f"{Path(view.name).stem}.npy", view.read_depth()[0].numpy())
        if view.read_fine_photo is not None:
            (folder / "fine").mkdir(exist_ok=True)
            write_image(folder / "fine" / view.name, view.read_fine_photo())
    write_cameras(folder / "cameras.json", views, sides)


def read_views(folder: Path) -> RenderedSet:
    """The set of a folder that `write_views` wrote; every read decodes a file.

    Raises:
        InputError: a file is missing or damaged.
    """
    rendered = read_run(folder)
    if not (folder / "fine").is_dir():
        return rendered
    return replace(
        rendered,
        targets=tuple(_with_fine(view, folder) for view in rendered.targets),
        references=tuple(_with_fine(view, folder) for view in rendered.references),
    )


def _with_fine(view: RenderedView, folder: Path) -> RenderedView:
    if view.camera is None:
        raise ValueError(f"{view.name} has no camera")
    height, width = UPSCALE * view.camera.height, UPSCALE * view.camera.width
    return replace(view, read_fine_photo=ReadPhoto(folder / "fine" / view.name, height, width, (0.0, 0.0, 0.0)))


@functools.lru_cache(maxsize=4)
def _scene(family: str, height: int, width: int) -> Scene:
    return procedural_scene(family, 0, height=height, width=width, points=0)


@functools.lru_cache(maxsize=4 * (REFERENCES + 1))
def _drawing(family: str, index: int, height: int, width: int) -> Float[Tensor, "3 {height} {width}"]:
    return _scene(family, height, width).photos[index].read()


def _view(scene: Scene, index: int, family: str, finer: bool) -> RenderedView:
    """A view of the scene; nothing is drawn yet."""
    photo = scene.photos[index]
    if photo.camera is None or photo.read_depth is None:
        raise ValueError("procedural scenes have cameras and depth")
    height, width = photo.camera.height, photo.camera.width
    drawn_height = max(1, round(height * min(1.0, DRAWN / width)))

    def read_photo(scale: int = 1) -> Float[Tensor, "3 _ _"]:
        return resize(_drawing(family, index, drawn_height, min(width, DRAWN)), scale * height, scale * width)

    def read() -> Float[Tensor, "3 h w"]:
        return resize(resize(read_photo(), max(1, height // 2), max(1, width // 2)), height, width)

    def alpha() -> Float[Tensor, "1 h w"]:
        return torch.ones(1, height, width)

    fine = functools.partial(read_photo, UPSCALE) if finer else None
    return RenderedView(photo.name, read, photo.camera, photo.read_depth, alpha, read_photo, fine)
