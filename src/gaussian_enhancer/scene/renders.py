"""Finished renders on disk: a fitted run's folder, the original 3DGS output, or bare folders of images.

A run holds ``test/ours_<step>/{renders,gt}`` and the same under ``train``; ours adds ``depth`` and ``alpha``. Where
``cameras.json`` states splits, views are matched to cameras by name; 3DGS numbers its renders instead, in the order
of its cameras, test cameras first. Sizes are compared from file headers when the set is made.
"""

import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import read_text, reader
from gaussian_enhancer.scene.cameras import (
    ListedCamera,
    cameras_by_stem,
    read_cameras,
    write_cameras,
    write_scene_cameras,
)
from gaussian_enhancer.scene.depth_files import ReadDepth, depth_size, find_depth
from gaussian_enhancer.scene.high_resolution import UPSCALE, is_finer, own_size
from gaussian_enhancer.scene.photos import list_images, read_header
from gaussian_enhancer.scene.posed import ReadCoverage, ReadPhoto
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.types import Camera

__all__ = ["read_folder", "read_run", "run_steps", "write_cameras", "write_scene_cameras"]

Colour = tuple[float, float, float]
BLACK: Colour = (0.0, 0.0, 0.0)
WHITE: Colour = (1.0, 1.0, 1.0)
OWN = ("config.yaml", "done")
"""What a finished run of this project's jobs holds, and no other program's output."""


@dataclass(frozen=True)
class _Folders:
    """Folders of the parts of one side's views; None for missing parts."""

    renders: Path
    photos: Path | None = None
    depth: Path | None = None
    alpha: Path | None = None


def run_steps(folder: Path, side: Literal["train", "test"] = "test") -> tuple[int, ...]:
    """Steps that a run has renders of, ascending."""
    matches = (re.fullmatch(r"ours_(\d+)", p.parent.name) for p in (folder / side).glob("ours_*/renders") if p.is_dir())
    return tuple(sorted(int(match[1]) for match in matches if match))


@reader
def read_run(
    folder: str | Path,
    step: int | None = None,
    *,
    capture: Scene | None = None,
    background: Colour | None = None,
    name: str = "",
) -> RenderedSet:
    """The held-out renders of a fitted run and its training views as references.

    Args:
        folder: the run's folder, ours or original 3DGS output.
        step: training step of the renders; the latest where None.
        capture: the scene that was fitted; its training photos are the references where the run kept no
            training views.
        background: colour under the renders; from 3DGS's ``cfg_args``, else black, where None.
        name: the set's name; the folder's where empty.

    Raises:
        InputError: there are no such renders, sizes of render, photo or depth differ, or cameras do not match.
    """
    root = Path(folder)
    chosen = _step(root, step)
    tests, trains = root / f"test/ours_{chosen}", root / f"train/ours_{chosen}"
    colour = background if background is not None else _background(root)
    cameras = read_cameras(root / "cameras.json") if (root / "cameras.json").is_file() else ()
    test_stems, train_stems = _stems(tests), _stems(trains) if (trains / "renders").is_dir() else []
    test_cameras, train_cameras = _match(cameras, test_stems, train_stems, root / "cameras.json")
    targets = _side(_parts(tests), test_cameras, colour)
    references = _side(_parts(trains), train_cameras, colour) if train_stems else _references(capture)
    if train_stems and not any(entry.split for entry in cameras):
        references = _told_apart(references)
    if any(view.read_photo is None for view in references):
        raise InputError(trains, "holds renders without gt photos", "render it again with its photos, or pass capture=")
    own = all((root / name).is_file() for name in OWN)
    return RenderedSet(name or root.resolve().name, targets, references, colour, own)


@reader
def read_folder(
    renders: str | Path,
    photos: str | Path | None = None,
    references: str | Path | Scene | None = None,
    depth: str | Path | None = None,
    cameras: str | Path | None = None,
    *,
    depth_scale: float = 1.0,
    background: Colour = BLACK,
    name: str = "",
    finer: bool = False,
) -> RenderedSet:
    """Read renders from a folder, with photos, depth and cameras where given. Files are matched by name without ending.

    Args:
        renders: folder of renders to enhance.
        photos: folder of the capture's photos. One with a render's name is that render's truth; the others are
            references, unless ``references`` is given. Where there are no others and the renders lie in a run's
            ``test/ours_<step>/renders``, the run's training views are the references (`read_run`).
        references: folder of photos to refer to, or a capture, whose training photos with their cameras are taken.
        depth: folder of z depth for renders (all of them) and references (those that have one):
            ``.npy``, ``.npz``, 16-bit ``.png``.
        cameras: a ``cameras.json`` in 3DGS's list format that names renders and references.
        depth_scale: scene units of one stored unit of depth.
        background: colour under transparent images.
        name: the set's name; the folder's where empty.
        finer: let photos be 4 times as fine as the renders, and read them as such too.

    Raises:
        InputError: no renders or no references, sizes of render, photo or depth differ, or a view lacks its camera.
    """
    root = Path(renders)
    files = {path.stem: path for path in _refuse_same_stems(list_images(root))}
    truths = {path.stem: path for path in _refuse_same_stems(list_images(Path(photos)))} if photos is not None else {}
    listed = cameras_by_stem(read_cameras(Path(cameras)), Path(cameras)) if cameras is not None else None
    depths = Path(depth) if depth is not None else None
    targets = []
    for stem, path in files.items():
        found = _depth_of(depths, stem, path, depth_scale, needed=True)
        camera = _camera_of(listed, stem, path, Path(cameras or ""))
        targets.append(_view(path, truths.get(stem), found, None, camera, background, finer))
    if isinstance(references, Scene):
        others = _references(references)
    else:
        named = list_images(Path(references)) if references is not None else list(truths.values())
        kept = [path for path in named if references is not None or path.stem not in files]
        others = tuple(_reference(p, listed, depths, depth_scale, Path(cameras or ""), background) for p in kept)
    if finer:
        others = tuple(replace(view, read_fine_photo=view.read_photo) for view in others)
    if not others:
        if photos is None:
            remedy = "name a folder of the capture's photos with photos= or references="
            raise InputError(root, "comes without photos", remedy)
        run, step = _run_of(root)
        if run is not None and run_steps(run, "train"):  # the pair of folders that 3DGS writes: its run has references
            return read_run(run, step, background=background, name=name)
        received = f"leaves no photo to refer to: {photos} holds the renders' own photos alone"
        remedy = "name a folder of the capture's other photos with references="
        raise InputError(root, received, remedy if run is None else f"{remedy}, or {_remedy(run)}")
    return RenderedSet(name or root.resolve().name, tuple(targets), others, background)


def _remedy(run: Path) -> str:
    """Advice for a run of 3DGS without training views, which names its capture in ``cfg_args``."""
    arguments = run / "cfg_args"
    match = re.search(r"source_path='([^']+)'", read_text(arguments)) if arguments.is_file() else None
    return f"run={run} scene=capture scene.path={match[1] if match else 'CAPTURE'}"


def _step(root: Path, step: int | None) -> int:
    if not root.is_dir():
        raise InputError(root, "is no folder", "name a fitted run's folder")
    os.scandir(root).close()  # globbing takes a folder that may not be read for an empty one
    steps = run_steps(root)
    if not steps:
        raise InputError(root, "holds no test/ours_<step>/renders", "name a fitted run's folder with held-out renders")
    if step is not None and step not in steps:
        raise InputError(root, f"has no renders of step {step}", f"choose one of {', '.join(map(str, steps))}")
    return steps[-1] if step is None else step


def _run_of(renders: Path) -> tuple[Path | None, int]:
    """The run and the step whose held-out renders a folder is, by its place; no run if it is none."""
    match = re.fullmatch(r"ours_(\d+)", renders.resolve().parent.name)
    if renders.name != "renders" or match is None or renders.resolve().parents[1].name != "test":
        return None, 0
    return renders.resolve().parents[2], int(match[1])


def _stems(side: Path) -> list[str]:
    return [path.stem for path in _refuse_same_stems(list_images(side / "renders"))]


def _refuse_same_stems(paths: list[Path]) -> list[Path]:
    """The files, given that no two differ by their ending only."""
    stems: dict[str, Path] = {}
    for path in paths:
        if path.stem in stems:
            raise InputError(path, f"has the name of {stems[path.stem].name}", "keep one image of each name")
        stems[path.stem] = path
    return paths


def _parts(side: Path) -> _Folders:
    optional = {part: side / part if (side / part).is_dir() else None for part in ("gt", "depth", "alpha")}
    return _Folders(side / "renders", optional["gt"], optional["depth"], optional["alpha"])


def _match(
    cameras: tuple[ListedCamera, ...], tests: list[str], trains: list[str], source: Path
) -> tuple[dict[str, Camera], dict[str, Camera]]:
    """Cameras of the test and the train renders, by stem; empty where there are none."""
    if not cameras:
        return {}, {}
    if all(entry.split is not None for entry in cameras):
        by_stem = cameras_by_stem(cameras, source)
        unknown = [stem for stem in (*tests, *trains) if stem not in by_stem]
        if unknown:
            raise InputError(source, f"lacks {len(unknown)} cameras, first {unknown[0]!r}", "write it again")
        return {stem: by_stem[stem] for stem in tests}, {stem: by_stem[stem] for stem in trains}
    expected = len(tests) + len(trains)
    if len(cameras) != expected and (trains or len(cameras) < expected):
        received = f"lists {len(cameras)} cameras for {len(tests)} test and {len(trains)} train renders"
        raise InputError(source, received, "use the cameras.json that was written with these renders")
    ordered = [entry.camera for entry in cameras]
    by_test = dict(zip(tests, ordered, strict=False))
    return by_test, dict(zip(trains, ordered[len(tests) :], strict=False))


def _side(folders: _Folders, cameras: dict[str, Camera], background: Colour) -> tuple[RenderedView, ...]:
    photos = {p.stem: p for p in list_images(folders.photos)} if folders.photos is not None else {}
    views = []
    for path in list_images(folders.renders):
        if folders.photos is not None and path.stem not in photos:
            raise InputError(folders.photos, f"has no photo for the render {path.name}", "render the run again")
        depth = _depth_of(folders.depth, path.stem, path, 1.0, needed=True)
        alpha = folders.alpha / f"{path.stem}.png" if folders.alpha is not None else None
        views.append(_view(path, photos.get(path.stem), depth, alpha, cameras.get(path.stem), background))
    return tuple(views)


def _depth_of(folder: Path | None, stem: str, image: Path, scale: float, *, needed: bool) -> ReadDepth | None:
    if folder is None:
        return None
    path = find_depth(folder, stem)
    if path is None:
        if needed:
            raise InputError(folder, f"has no depth for {image.name}", "add it or leave depth out")
        return None
    return ReadDepth(path, scale)


def _camera_of(listed: dict[str, Camera] | None, stem: str, image: Path, source: Path) -> Camera | None:
    if listed is None:
        return None
    if stem not in listed:
        raise InputError(source, f"names no camera for {image.name}", "add it or leave cameras out")
    return listed[stem]


def _view(
    render: Path,
    photo: Path | None,
    depth: ReadDepth | None,
    alpha: Path | None,
    camera: Camera | None,
    background: Colour,
    finer: bool = False,
) -> RenderedView:
    """One target with its parts, whose sizes must agree; a camera of another size with the same aspect follows.

    With ``finer`` the photo may be 4 times as fine instead.
    """
    header = read_header(render)
    size = header.height, header.width
    fine, fine_size = None, None
    if photo is not None:
        found = read_header(photo).height, read_header(photo).width
        if finer and is_finer(found, size):
            fine = ReadPhoto(photo, UPSCALE * size[0], UPSCALE * size[1], background)
            fine_size = own_size(found, size)
        else:
            _same_size(render, size, photo, found)
    if depth is not None:
        _same_size(render, size, depth.path, depth_size(depth.path))
    if alpha is not None:
        _same_size(render, size, alpha, (read_header(alpha).height, read_header(alpha).width))
    own_alpha = render if header.has_alpha else None
    coverage = alpha if alpha is not None else own_alpha
    return RenderedView(
        render.name,
        ReadPhoto(render, *size, background),
        _sized(camera, size, render) if camera is not None else None,
        depth,
        ReadCoverage(coverage, *size) if coverage is not None else None,
        ReadPhoto(photo, *size, background) if photo is not None else None,
        fine,
        fine_size,
    )


def _reference(
    path: Path,
    listed: dict[str, Camera] | None,
    depths: Path | None,
    scale: float,
    source: Path,
    background: Colour,
) -> RenderedView:
    header = read_header(path)
    size = header.height, header.width
    depth = _depth_of(depths, path.stem, path, scale, needed=False)
    camera = _camera_of(listed, path.stem, path, source)
    return RenderedView(
        path.name,
        None,
        _sized(camera, size, path) if camera is not None else None,
        depth,
        None,
        ReadPhoto(path, *size, background),
    )


def _told_apart(references: tuple[RenderedView, ...]) -> tuple[RenderedView, ...]:
    """Training views by names of their own: 3DGS numbers both sides from 0, and no view refers to one of its name."""
    numbered = re.compile(r"\d{5}\.\w+")
    return tuple(replace(v, name=f"train_{v.name}") if numbered.fullmatch(v.name) else v for v in references)


def _references(capture: Scene | None) -> tuple[RenderedView, ...]:
    photos = capture.train_photos if capture is not None else ()
    return tuple(RenderedView(photo.name, None, photo.camera, read_photo=photo.read) for photo in photos)


def _same_size(render: Path, size: tuple[int, int], other: Path, found: tuple[int, int]) -> None:
    if size != found:
        received = f"is {found[1]}x{found[0]} but its render {render.name} is {size[1]}x{size[0]}"
        raise InputError(other, received, "bring both to the same size")


def _sized(camera: Camera, size: tuple[int, int], image: Path) -> Camera:
    height, width = size
    shrink = min(width / camera.width, height / camera.height)
    if abs(width - camera.width * shrink) > 1 or abs(height - camera.height * shrink) > 1:
        received = f"is {width}x{height} but its camera is {camera.width}x{camera.height}"
        raise InputError(image, received, "use the camera that it was rendered with")
    return camera.resized(height, width)


def _background(root: Path) -> Colour:
    """3DGS keeps ``white_background=True`` in the text of its arguments."""
    arguments = root / "cfg_args"
    if arguments.is_file() and re.search(r"white_background=True", read_text(arguments)):
        return WHITE
    return BLACK
