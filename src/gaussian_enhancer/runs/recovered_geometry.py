"""Cameras and depth that renders come without, recovered from the images and kept on disk.

Cameras come from structure from motion of renders and photos together. Depth comes from a plane sweep: each image is
compared with photos at many depths. The truth of a render, a photo of its own view, takes no part.
Axes: h height, w width.
"""

import hashlib
import json
import math
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import load_array, save_array, write_text
from gaussian_enhancer.runs import lock
from gaussian_enhancer.runs.run import digest_of
from gaussian_enhancer.scene.colmap import camera_pose, read_model
from gaussian_enhancer.scene.colmap_model import ColmapImage, ColmapModel
from gaussian_enhancer.scene.json_file import member, number, read_json
from gaussian_enhancer.scene.photos import resize
from gaussian_enhancer.scene.posed import ReadPhoto
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.scene import Points
from gaussian_enhancer.scene.structure_from_motion import Told, UnposedImage, reconstruct
from gaussian_enhancer.scene.undistort import Lens, ideal_pinhole, undistort
from gaussian_enhancer.types import Camera, orthonormal_pose

SWEPT_PIXELS = 60_000
"""Pixels of an image that depth is searched at; larger images are made smaller first."""
ENOUGH = 2
"""Photos that must have a camera: fewer tell no depth."""
STRAIGHT = 0.5
"""Pixels in a photo's corner up to which distortion is left alone, so that the photo is not resampled for it."""
SUMMARY, CAMERAS, DEPTH = "geometry.json", "cameras", "depth"
"""What is written: a summary, a COLMAP model, and a depth map a view."""
RENDER, PHOTO = "render", "photo"
"""What names of files begin with, before the view's number."""
PARTS = {
    "features": "structure from motion: features",
    "matches": "structure from motion: matches",
    "cameras": "structure from motion: cameras",
    "depth": "plane sweep",
}
"""What the bar shows of each part of the work."""
Read = Callable[[], Tensor]


class RecoveryProgress:
    """A bar on a terminal's standard error once there is something to do, or nothing.

    Args:
        shown: whether to show it.
    """

    def __init__(self, shown: bool) -> None:
        console = Console(stderr=True)
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
        self._bar = Progress(*columns, console=console, disable=not (shown and console.is_terminal))
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> "RecoveryProgress":
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def update(self, part: str, done: int, total: int) -> None:
        """Show how much of a part is done.

        Args:
            part: one of `PARTS`.
            done: how much of it.
            total: all of it.
        """
        if part not in self._tasks:
            self._bar.start()
            self._tasks[part] = self._bar.add_task(PARTS[part], total=total)
        self._bar.update(self._tasks[part], completed=done)


@dataclass(frozen=True)
class Recovered:
    """A set with what was recovered of its geometry.

    Args:
        rendered: the set; renders that found no camera have none, and photos that found none are left out.
        cameras: where cameras come from, or why there are none; empty where they were given.
        depth: where depth comes from; empty where it was given, or there is none.
    """

    rendered: RenderedSet
    cameras: str = ""
    depth: str = ""


def lacks_geometry(rendered: RenderedSet) -> bool:
    """Whether a set has photos to refer to, and renders without the cameras or depth that warping them takes."""
    views = rendered.targets
    return bool(rendered.references) and (_lacks_cameras(rendered) or any(view.read_depth is None for view in views))


def recover_geometry(rendered: RenderedSet, root: Path, progress: Told | None = None) -> Recovered:
    """The set with cameras and depth, those of an earlier call where its images are the same.

    Where a render has no camera, all cameras are recovered, and depth with them, since the scale is another.

    Args:
        rendered: renders and photos.
        root: folder that keeps what is recovered, in a folder of the set's name and a digest of its images.
        progress: told how far the work is; not called where it was done before.

    Raises:
        InputError: an image cannot be read, or the folder cannot be written.
    """
    bare = _lacks_cameras(rendered)
    folder = root / f"{rendered.name}-{digest_of({'images': _identities(rendered, bare)})}"
    if not (folder / SUMMARY).is_file():
        with lock.wait_for_holders():
            new = lock.hold(folder)
        try:
            if not (folder / SUMMARY).is_file():
                _recover_missing(rendered, bare, folder, progress)
        finally:
            if new:
                lock.release(folder)
    return _read(rendered, bare, folder)


def _lacks_cameras(rendered: RenderedSet) -> bool:
    views = rendered.references
    return any(view.camera is None for view in rendered.targets) or all(view.camera is None for view in views)


def _recover_missing(rendered: RenderedSet, bare: bool, folder: Path, progress: Told | None) -> None:
    """Recover what is missing, and write it; parts that a killed call left are made again."""
    started = time.monotonic()
    try:
        _clear(folder)
        complete = not bare or reconstruct(_unposed(rendered), folder / CAMERAS, progress)
        posed = _posed(rendered, bare, folder) if complete else rendered
        middle = time.monotonic()
        complete = _check_cameras(posed)
        if complete:
            _write_depths(posed, read_model(folder / CAMERAS).points if bare else None, folder / DEPTH, progress)
        else:
            _clear(folder)
    except BaseException:
        _clear(folder)
        raise
    seconds = {CAMERAS: round(middle - started, 1), DEPTH: round(time.monotonic() - middle, 1)}
    write_text(folder / SUMMARY, json.dumps({"found": complete, "seconds": seconds}) + "\n")


def _clear(folder: Path) -> None:
    for part in (CAMERAS, DEPTH):
        shutil.rmtree(folder / part, ignore_errors=True)


def _read(rendered: RenderedSet, bare: bool, folder: Path) -> Recovered:
    """The set with what was written."""
    source = folder / SUMMARY
    summary = read_json(source)
    times = member(summary, "seconds", source)
    taken = {part: number(times, part, f"{source} seconds") for part in (CAMERAS, DEPTH)}
    count = len(rendered.targets), len(rendered.references)
    if not member(summary, "found", source):
        tried = f"structure from motion of {count[0]} renders and {count[1]} photos"
        return Recovered(rendered, f"{tried} found no place that they share, {taken[CAMERAS]:.0f} s" if bare else "")
    posed = _posed(rendered, bare, folder)
    targets = tuple(_with_depth(view, folder / DEPTH / f"{RENDER}_{i:05d}.npy") for i, view in enumerate(posed.targets))
    references = [_with_depth(v, folder / DEPTH / f"{PHOTO}_{i:05d}.npy") for i, v in enumerate(posed.references)]
    kept = tuple(view for view in references if view.camera is not None or not bare)
    posed_set = replace(posed, targets=targets, references=kept, own_depth=False)
    depth = f"by plane sweep, {taken[DEPTH]:.0f} s; kept in {folder}"
    if not bare:
        return Recovered(posed_set, "", depth)
    if any(view.read_depth is not None for view in rendered.targets):
        depth += "; the given depth is left out, since its unit is not that of recovered cameras"
    placed = f"{sum(v.camera is not None for v in targets)} of {count[0]} renders, {len(kept)} of {count[1]} photos"
    return Recovered(posed_set, f"by structure from motion: {placed}, {taken[CAMERAS]:.0f} s", depth)


def _check_cameras(posed: RenderedSet) -> bool:
    photos = sum(view.camera is not None for view in posed.references)
    return photos >= ENOUGH and any(view.camera is not None for view in posed.targets)


def _unposed(rendered: RenderedSet) -> list[UnposedImage]:
    """Renders and photos, by the names that `_posed` finds them by."""
    renders = [
        UnposedImage(f"{RENDER}_{i:05d}.png", _render_of(view), True, True) for i, view in enumerate(rendered.targets)
    ]
    return renders + [
        UnposedImage(f"{PHOTO}_{i:05d}.png", _photo_of(view), view.camera is not None or view.read is not None, False)
        for i, view in enumerate(rendered.references)
    ]


def _posed(rendered: RenderedSet, bare: bool, folder: Path) -> RenderedSet:
    """The set with its own cameras, or with those of the model; what the model does not list has none."""
    if not bare:
        return rendered
    model = read_model(folder / CAMERAS)
    listed = {image.name: image for image in model.images}

    def camera(name: str, read: Read) -> tuple[Camera | None, Lens | None]:
        image = listed.get(name)
        return (None, None) if image is None else _camera(model, image, read)

    targets = []
    for i, view in enumerate(rendered.targets):
        found, _ = camera(f"{RENDER}_{i:05d}.png", _render_of(view))
        targets.append(replace(view, camera=found, read_depth=None))
    references = []
    for i, view in enumerate(rendered.references):
        found, lens = camera(f"{PHOTO}_{i:05d}.png", _photo_of(view))
        references.append(_undistorted(replace(view, camera=found, read_depth=None), lens))
    return replace(rendered, targets=tuple(targets), references=tuple(references))


def _camera(model: ColmapModel, image: ColmapImage, read: Read) -> tuple[Camera, Lens]:
    """The ideal pinhole camera of an image at its own size, and its lens."""
    lens = model.cameras[image.camera].resized(*_size(read))
    if lens.model == "SIMPLE_RADIAL":
        focal, x, y, k = lens.params
        radius = math.hypot(lens.width, lens.height) / (2 * focal)
        if abs(k) * radius**3 * focal < STRAIGHT:
            lens = replace(lens, model="SIMPLE_PINHOLE", params=(focal, x, y))
    K, height, width = ideal_pinhole(lens)
    return Camera(K.float(), orthonormal_pose(camera_pose(image), image.name).float(), height, width), lens


def _undistorted(view: RenderedView, lens: Lens | None) -> RenderedView:
    """A photo that is undistorted when it is read."""
    if lens is None or view.camera is None or not lens.distorted:
        return view
    read = _photo_of(view)
    if isinstance(read, ReadPhoto) and read.lens is None:
        undistorted: Read = replace(read, height=view.camera.height, width=view.camera.width, lens=lens)
    else:
        undistorted = ReadUndistorted(read, lens)
    return replace(view, read_photo=undistorted, read_fine_photo=undistorted if view.read_fine_photo else None)


def _write_depths(rendered: RenderedSet, points: Points | None, folder: Path, progress: Told | None) -> None:
    """Sweep every view that has a camera, and write its depth; photos come last, which all are compared with."""
    from gaussian_enhancer.splat.fit.plane_sweep import SweepSettings, sweep_depths

    settings = SweepSettings(neighbours=4, reduction=1)
    views = [(f"{RENDER}_{i:05d}.npy", v, _render_of(v)) for i, v in enumerate(rendered.targets)]
    views += [(f"{PHOTO}_{i:05d}.npy", v, _photo_of(v)) for i, v in enumerate(rendered.references)]
    names, images, cameras = [], [], []
    for name, view, read in views:
        if view.camera is not None:
            image = read()
            shrink = min(1.0, (SWEPT_PIXELS / (image.shape[-2] * image.shape[-1])) ** 0.5)
            size = [max(8, round(side * shrink)) for side in image.shape[-2:]]
            names.append(name)
            images.append(resize(image, *size))
            cameras.append(view.camera.resized(*size))
    photos = sum(view.camera is not None for view in rendered.references)
    advance = None if progress is None else lambda done, total: progress(DEPTH, done, total)
    known_points = Points(torch.empty(0, 3), torch.empty(0, 3)) if points is None else points
    for name, depth in zip(
        names, sweep_depths(images, cameras, photos, known_points, settings, progress=advance), strict=True
    ):
        save_array(folder / name, depth[0].numpy().astype(np.float32))


def _with_depth(view: RenderedView, path: Path) -> RenderedView:
    if view.camera is None:
        return view
    return replace(view, read_depth=ReadSweptDepth(path, view.camera.height, view.camera.width))


@dataclass(frozen=True)
class ReadSweptDepth:
    """Reads a swept depth map at the size of its view. Picklable for worker processes."""

    path: Path
    height: int
    width: int

    def __call__(self) -> Float[Tensor, "1 h w"]:
        """Z depth in scene units; between samples inverse depth, in which planes are linear, is interpolated."""
        try:
            stored = torch.from_numpy(np.array(load_array(self.path)))
        except (OSError, ValueError, EOFError) as error:
            raise InputError(self.path, f"cannot be read ({error})", f"delete {self.path.parents[1]}") from error
        inverse = (1 / stored)[None, None]
        return 1 / F.interpolate(inverse, (self.height, self.width), mode="bilinear", align_corners=False)[0]


@dataclass(frozen=True)
class ReadUndistorted:
    """Reads a photo as an ideal pinhole camera sees it."""

    read: Read
    lens: Lens

    def __call__(self) -> Float[Tensor, "3 h w"]:
        """The photo, shape (3, height, width), [0, 1]."""
        return undistort(self.read(), self.lens)


def _render_of(view: RenderedView) -> Read:
    if view.read is None:
        raise InputError(view.name, "has no render to enhance", "render it first")
    return view.read


def _photo_of(view: RenderedView) -> Read:
    if view.read_photo is None:
        raise InputError(view.name, "has no photo to refer to", "give the photo, or leave the view out")
    return view.read_photo


def _size(read: Read) -> tuple[int, int]:
    if isinstance(read, ReadPhoto):
        return read.height, read.width
    height, width = read().shape[-2:]
    return height, width


def _identities(rendered: RenderedSet, bare: bool) -> list[list[object]]:
    """What recovered geometry depends on: the images, and cameras where they were given."""

    def identity(kind: str, view: RenderedView, read: Read) -> list[object]:
        matrices: Sequence[Tensor] = () if bare or view.camera is None else (view.camera.K, view.camera.world_to_camera)
        return [kind, view.read is None, _content_key(read), [matrix.tolist() for matrix in matrices]]

    renders = [identity("render", view, _render_of(view)) for view in rendered.targets]
    return renders + [identity("photo", view, _photo_of(view)) for view in rendered.references]


def _content_key(read: Read) -> str:
    """What tells an image from others: its file with size and time of change, or its pixels."""
    if isinstance(read, ReadPhoto):
        state = read.path.stat()
        return f"{read.path.resolve()} {state.st_size} {state.st_mtime_ns} {read.height} {read.width} {read.lens}"
    return hashlib.sha256(read().numpy().tobytes()).hexdigest()
