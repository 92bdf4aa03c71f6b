"""Recovers missing cameras and depth of renders from the images, and keeps them on disk.

Cameras come from structure from motion of renders and photos together. Depth comes from a plane sweep, which compares
each image with photos at many depths. The ground truth of a render, a photo of the same view, is not used.
Axes: h height, w width.
"""

import hashlib
import math
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from rich.console import Console
from rich.progress import MofNCompleteColumn, TaskID, TimeElapsedColumn
from torch import Tensor

from gaussian_enhancer.console import progress_bar
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import load_array, save_array, write_json
from gaussian_enhancer.runs import lock
from gaussian_enhancer.runs.run import digest_of
from gaussian_enhancer.scene.colmap import camera_pose, read_model
from gaussian_enhancer.scene.colmap_model import ColmapImage, ColmapModel
from gaussian_enhancer.scene.json_file import get_member, get_number, read_json
from gaussian_enhancer.scene.photos import resize
from gaussian_enhancer.scene.posed import ReadPhoto
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.scene import Points
from gaussian_enhancer.scene.structure_from_motion import ProgressCallback, UnposedImage, reconstruct
from gaussian_enhancer.scene.undistort import Lens, ideal_pinhole, undistort
from gaussian_enhancer.types import Camera, orthonormal_pose

SWEPT_PIXELS = 60_000
"""Maximum number of pixels of an image in the plane sweep; larger images are reduced first."""
MIN_PHOTOS = 2
"""Minimum number of photos with a camera; depth cannot be recovered from fewer."""
MAX_DISTORTION = 0.5
"""Distortion in pixels at a photo's corner below which the photo is not undistorted, which avoids resampling it."""
SUMMARY, CAMERAS, DEPTH = "geometry.json", "cameras", "depth"
"""Names of the outputs: a summary, a COLMAP model, and a depth map for each view."""
RENDER, PHOTO = "render", "photo"
"""Prefixes of file names, followed by the view's number."""
PROGRESS_LABELS = {
    "features": "structure from motion: features",
    "matches": "structure from motion: matches",
    "cameras": "structure from motion: cameras",
    "depth": "plane sweep",
}
"""Labels of the progress bar by step of the recovery."""
Read = Callable[[], Tensor]


@contextmanager
def recovery_progress(shown: bool) -> Iterator[ProgressCallback]:
    """A progress bar on standard error, if that is a terminal; it appears with the first call of the callback.

    Args:
        shown: whether to show the bar.
    """
    console = Console(stderr=True)
    hidden = not (shown and console.is_terminal)
    bar = progress_bar(MofNCompleteColumn(), TimeElapsedColumn(), hidden=hidden, console=console)
    tasks: dict[str, TaskID] = {}

    def update(step: str, done: int, total: int) -> None:
        if step not in tasks:
            bar.start()
            tasks[step] = bar.add_task(PROGRESS_LABELS[step], total=total)
        bar.update(tasks[step], completed=done)

    try:
        yield update
    finally:
        bar.stop()


@dataclass(frozen=True)
class RecoveredGeometry:
    """A set with its recovered geometry.

    Args:
        rendered: the set; renders whose camera was not recovered have none, and such photos are left out.
        cameras: how cameras were recovered, or why they could not be; empty if they were given.
        depth: how depth was recovered, or why it could not be although cameras were given; empty otherwise.
    """

    rendered: RenderedSet
    cameras: str = ""
    depth: str = ""


def lacks_geometry(rendered: RenderedSet) -> bool:
    """Whether a set has photos, but renders without the cameras or depth that warping requires."""
    views = rendered.targets
    return bool(rendered.references) and (_lacks_cameras(rendered) or any(view.read_depth is None for view in views))


def recover_geometry(rendered: RenderedSet, root: Path, progress: ProgressCallback | None = None) -> RecoveredGeometry:
    """The set with recovered cameras and depth. Results of an earlier call for the same images are reused.

    If a render has no camera, or if no photo has one, all cameras are recovered, and all depth as well, since recovered
    cameras have another scale.

    Args:
        rendered: renders and photos.
        root: folder of results; they are kept in a subfolder named by the set and a digest of its images.
        progress: callback for progress; not called if an earlier result is reused.

    Raises:
        InputError: an image cannot be read, or the folder cannot be written.
    """
    lacks_cameras = _lacks_cameras(rendered)
    folder = root / f"{rendered.name}-{digest_of({'images': _identities(rendered, lacks_cameras)})}"
    if not (folder / SUMMARY).is_file():
        with lock.exclusive(folder, wait=True):
            if not (folder / SUMMARY).is_file():
                _recover_missing(rendered, lacks_cameras, folder, progress)
    return _read(rendered, lacks_cameras, folder)


def _lacks_cameras(rendered: RenderedSet) -> bool:
    views = rendered.references
    return any(view.camera is None for view in rendered.targets) or all(view.camera is None for view in views)


def _recover_missing(
    rendered: RenderedSet, lacks_cameras: bool, folder: Path, progress: ProgressCallback | None
) -> None:
    """Recover the missing geometry and write it; parts left by a killed call are computed again."""
    started = time.monotonic()
    try:
        _clear(folder)
        reconstructed = not lacks_cameras or reconstruct(_unposed(rendered), folder / CAMERAS, progress)
        posed = _with_cameras(rendered, lacks_cameras, folder) if reconstructed else rendered
        cameras_done = time.monotonic()
        recovered = _suffices_for_depth(posed)
        if recovered:
            _write_depths(
                posed, read_model(folder / CAMERAS).points if lacks_cameras else None, folder / DEPTH, progress
            )
        else:
            _clear(folder)
    except BaseException:
        _clear(folder)
        raise
    seconds = {CAMERAS: round(cameras_done - started, 1), DEPTH: round(time.monotonic() - cameras_done, 1)}
    write_json(folder / SUMMARY, {"found": recovered, "seconds": seconds})


def _clear(folder: Path) -> None:
    for name in (CAMERAS, DEPTH):
        shutil.rmtree(folder / name, ignore_errors=True)


def _read(rendered: RenderedSet, lacks_cameras: bool, folder: Path) -> RecoveredGeometry:
    """The set with the geometry that is stored in a folder."""
    source = folder / SUMMARY
    summary = read_json(source)
    durations = get_member(summary, "seconds", source)
    seconds = {name: get_number(durations, name, f"{source} seconds") for name in (CAMERAS, DEPTH)}
    render_count, photo_count = len(rendered.targets), len(rendered.references)
    if not get_member(summary, "found", source):
        if not lacks_cameras:
            return RecoveredGeometry(rendered, "", f"depth is recovered from at least {MIN_PHOTOS} photos with cameras")
        attempt = f"structure from motion of {render_count} renders and {photo_count} photos"
        return RecoveredGeometry(rendered, f"{attempt} found no place that they share, {seconds[CAMERAS]:.0f} s")
    posed = _with_cameras(rendered, lacks_cameras, folder)
    views = tuple(_with_depth(view, folder / DEPTH / f"{stem}.npy") for stem, view, _ in _images(posed))
    targets = views[:render_count]
    photos = tuple(view for view in views[render_count:] if view.camera is not None or not lacks_cameras)
    posed_set = replace(posed, targets=targets, references=photos, own_depth=False)
    depth = f"by plane sweep, {seconds[DEPTH]:.0f} s; kept in {folder}"
    if not lacks_cameras:
        return RecoveredGeometry(posed_set, "", depth)
    if any(view.read_depth is not None for view in rendered.targets):
        depth += "; the given depth is ignored, because its unit differs from that of the recovered cameras"
    posed_count = sum(view.camera is not None for view in targets)
    counts = f"{posed_count} of {render_count} renders, {len(photos)} of {photo_count} photos"
    return RecoveredGeometry(posed_set, f"by structure from motion: {counts}, {seconds[CAMERAS]:.0f} s", depth)


def _suffices_for_depth(posed: RenderedSet) -> bool:
    """Whether a render and enough photos have a camera for the plane sweep."""
    photos = sum(view.camera is not None for view in posed.references)
    return photos >= MIN_PHOTOS and any(view.camera is not None for view in posed.targets)


def _images(rendered: RenderedSet) -> list[tuple[str, RenderedView, Read]]:
    """Each view, renders first: the stem of its files, the view, and the reader of its render or its photo."""
    renders = [(f"{RENDER}_{i:05d}", view, _render_of(view)) for i, view in enumerate(rendered.targets)]
    return renders + [(f"{PHOTO}_{i:05d}", view, _photo_of(view)) for i, view in enumerate(rendered.references)]


def _unposed(rendered: RenderedSet) -> list[UnposedImage]:
    """Renders and photos as input of structure from motion, under the names by which `_with_cameras` looks them up."""
    return [
        UnposedImage(f"{stem}.png", read, view.camera is not None or view.read is not None, stem.startswith(RENDER))
        for stem, view, read in _images(rendered)
    ]


def _with_cameras(rendered: RenderedSet, lacks_cameras: bool, folder: Path) -> RenderedSet:
    """The set with the given cameras or with those of the model; views that are not in the model have no camera."""
    if not lacks_cameras:
        return rendered
    model = read_model(folder / CAMERAS)
    model_images = {image.name: image for image in model.images}
    views = []
    for stem, view, read in _images(rendered):
        image = model_images.get(f"{stem}.png")
        camera, lens = (None, None) if image is None else _camera(model, image, read)
        posed = replace(view, camera=camera, read_depth=None)
        views.append(_undistort_photo(posed, lens) if stem.startswith(PHOTO) else posed)
    count = len(rendered.targets)
    return replace(rendered, targets=tuple(views[:count]), references=tuple(views[count:]))


def _camera(model: ColmapModel, image: ColmapImage, read: Read) -> tuple[Camera, Lens]:
    """The ideal pinhole camera of an image at its full size, and its lens."""
    lens = model.cameras[image.camera].resized(*_size(read))
    if lens.model == "SIMPLE_RADIAL":
        focal, x, y, k = lens.params
        radius = math.hypot(lens.width, lens.height) / (2 * focal)
        if abs(k) * radius**3 * focal < MAX_DISTORTION:
            lens = replace(lens, model="SIMPLE_PINHOLE", params=(focal, x, y))
    K, height, width = ideal_pinhole(lens)
    return Camera(K.float(), orthonormal_pose(camera_pose(image), image.name).float(), height, width), lens


def _undistort_photo(view: RenderedView, lens: Lens | None) -> RenderedView:
    """The view with a photo that is undistorted when it is read."""
    if lens is None or view.camera is None or not lens.distorted:
        return view
    read = _photo_of(view)
    if isinstance(read, ReadPhoto) and read.lens is None:
        undistorted: Read = replace(read, height=view.camera.height, width=view.camera.width, lens=lens)
    else:
        undistorted = ReadUndistorted(read, lens)
    return replace(view, read_photo=undistorted, read_fine_photo=undistorted if view.read_fine_photo else None)


def _write_depths(
    rendered: RenderedSet, points: Points | None, folder: Path, progress: ProgressCallback | None
) -> None:
    """Compute and write the depth of each view with a camera. Photos come last; all views are compared with them."""
    from gaussian_enhancer.splat.fit.plane_sweep import SweepSettings, sweep_depths

    settings = SweepSettings(neighbours=4, reduction=1)
    files, images, cameras = [], [], []
    for stem, view, read in _images(rendered):
        if view.camera is not None:
            image = read()
            shrink = min(1.0, (SWEPT_PIXELS / (image.shape[-2] * image.shape[-1])) ** 0.5)
            size = [max(8, round(side * shrink)) for side in image.shape[-2:]]
            files.append(folder / f"{stem}.npy")
            images.append(resize(image, *size))
            cameras.append(view.camera.resized(*size))
    photos = sum(view.camera is not None for view in rendered.references)
    advance = None if progress is None else lambda done, total: progress(DEPTH, done, total)
    known_points = Points(torch.empty(0, 3), torch.empty(0, 3)) if points is None else points
    depths = sweep_depths(images, cameras, photos, known_points, settings, progress=advance)
    for file, depth in zip(files, depths, strict=True):
        save_array(file, depth[0].numpy().astype(np.float32))


def _with_depth(view: RenderedView, path: Path) -> RenderedView:
    if view.camera is None:
        return view
    return replace(view, read_depth=ReadSweptDepth(path, view.camera.height, view.camera.width))


@dataclass(frozen=True)
class ReadSweptDepth:
    """Reads a depth map of the plane sweep at the size of its view. Picklable for worker processes."""

    path: Path
    height: int
    width: int

    def __call__(self) -> Float[Tensor, "1 h w"]:
        """Z depth in scene units. Inverse depth is interpolated, since it is linear on planes."""
        try:
            stored = torch.from_numpy(np.array(load_array(self.path)))
        except (OSError, ValueError, EOFError) as error:
            raise InputError(self.path, f"cannot be read ({error})", f"delete {self.path.parents[1]}") from error
        inverse = (1 / stored)[None, None]
        return 1 / F.interpolate(inverse, (self.height, self.width), mode="bilinear", align_corners=False)[0]


@dataclass(frozen=True)
class ReadUndistorted:
    """Reads a photo and undistorts it to an ideal pinhole camera."""

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


def _identities(rendered: RenderedSet, lacks_cameras: bool) -> list[list[object]]:
    """The data that recovered geometry depends on: the images, and cameras if they were given."""
    identities: list[list[object]] = []
    for stem, view, read in _images(rendered):
        given = None if lacks_cameras else view.camera
        matrices = [] if given is None else [given.K.tolist(), given.world_to_camera.tolist()]
        identities.append([stem.partition("_")[0], view.read is None, _content_key(read), matrices])
    return identities


def _content_key(read: Read) -> str:
    """Identity of an image: its file with size and modification time, or a hash of its pixels."""
    if isinstance(read, ReadPhoto):
        state = read.path.stat()
        return f"{read.path.resolve()} {state.st_size} {state.st_mtime_ns} {read.height} {read.width} {read.lens}"
    return hashlib.sha256(read().numpy().tobytes()).hexdigest()
