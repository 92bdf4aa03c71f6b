"""Finished renders on disk: a fitted run's folder, the original 3DGS output, or bare folders of images.

A run holds ``test/ours_<step>/{renders,gt}`` and the same under ``train``; this project's runs add ``depth`` and
``alpha``. Where ``cameras.json`` states splits, views are matched to cameras by name. 3DGS states none and numbers its
renders in the order of its cameras, test cameras first. Sizes are compared, from file headers, when the set is made.
"""

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Literal

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import read_text, reader
from gaussian_enhancer.scene.cameras import ListedCamera, cameras_by_stem, read_cameras
from gaussian_enhancer.scene.depth_files import ReadDepth, depth_size, find_depth
from gaussian_enhancer.scene.high_resolution import UPSCALE, is_finer, original_size
from gaussian_enhancer.scene.photos import background_colour, images_by_stem, list_images, read_header
from gaussian_enhancer.scene.posed import ReadCoverage, ReadPhoto, evenly_resized
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.types import Camera

Colour = tuple[float, float, float]
BLACK: Colour = (0.0, 0.0, 0.0)
WHITE: Colour = (1.0, 1.0, 1.0)
OWN_RUN_FILES = ("config.yaml", "done")
"""Files that every finished run of this project's jobs holds and other programs' output lacks."""


def run_steps(folder: Path, side: Literal["train", "test"] = "test") -> tuple[int, ...]:
    """Training steps whose renders a run contains, ascending."""
    matches = (re.fullmatch(r"ours_(\d+)", p.parent.name) for p in (folder / side).glob("ours_*/renders") if p.is_dir())
    return tuple(sorted(int(match[1]) for match in matches if match))


@reader
def choose_step(root: Path, step: int | None = None) -> int:
    """The training step whose held-out renders are read: the given one, or the latest.

    Args:
        root: a run's folder.
        step: training step; None takes the latest.

    Raises:
        InputError: the folder does not exist, cannot be read, or has no such renders.
    """
    if not root.is_dir():
        raise InputError(root, "is no folder", "name a fitted run's folder")
    os.scandir(root).close()  # raises for an unreadable folder, which glob treats as empty
    steps = run_steps(root)
    if not steps:
        remedy = "name a fitted run's folder with held-out renders"
        splat = root / "splat.ply" if (root / "splat.ply").is_file() else root
        if splat != root or (root / "point_cloud").is_dir():
            remedy += f", or render its splat: gaussians={splat} {_scene_options(root)}"
        raise InputError(root, "holds no test/ours_<step>/renders", remedy)
    if step is not None and step not in steps:
        raise InputError(root, f"has no renders of step {step}", f"choose one of {', '.join(map(str, steps))}")
    return steps[-1] if step is None else step


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
        folder: the run's folder, made by this project or by the original 3DGS.
        step: training step of the renders; the latest where None.
        capture: the scene that was fitted; its training photos are the references where the run contains no
            training views.
        background: colour under the renders. Where None, it is read from ``cfg_args``; without that file it is black.
        name: the set's name; the folder's where empty.

    Raises:
        InputError: there are no such renders, a training render has no photo, the sizes of render, photo or depth
            differ, or cameras do not match.
    """
    root = Path(folder)
    chosen_step = choose_step(root, step)
    test_folder, train_folder = root / f"test/ours_{chosen_step}", root / f"train/ours_{chosen_step}"
    background_colour = background if background is not None else _background(root)
    cameras = read_cameras(root / "cameras.json") if (root / "cameras.json").is_file() else ()
    test_stems, train_stems = _stems(test_folder), _stems(train_folder) if (train_folder / "renders").is_dir() else []
    test_cameras, train_cameras = _match(cameras, test_stems, train_stems, root / "cameras.json")
    targets = _read_split(test_folder, test_cameras, background_colour)
    references = _read_split(train_folder, train_cameras, background_colour) if train_stems else _references(capture)
    if train_stems and not any(entry.split for entry in cameras):
        references = _rename_references(references)
    if any(view.read_photo is None for view in references):
        remedy = "render it again with its photos, or pass capture="
        raise InputError(train_folder, "holds renders without gt photos", remedy)
    own_depth = all((root / name).is_file() for name in OWN_RUN_FILES)
    return RenderedSet(name or root.resolve().name, targets, references, background_colour, own_depth)


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
        photos: folder of the capture's photos. A photo with a render's name is that render's ground truth. The other
            photos are references, unless ``references`` is given. If there are no others and the renders lie in a
            run's ``test/ours_<step>/renders``, the run's training views are the references (`read_run`), and its
            cameras and depth are used where none are given.
        references: folder of reference photos, or a capture, whose training photos and cameras are used.
        depth: folder of z depth maps (``.npy``, ``.npz``, 16-bit ``.png``), required for all renders and optional for
            references.
        cameras: a ``cameras.json`` in 3DGS's list format that names all renders; references that it does not name
            have no camera.
        depth_scale: scene units per stored unit of depth.
        background: colour under transparent images.
        name: the set's name; the folder's where empty.
        finer: accept ground truth at 4 times the renders' resolution. It and the photos of all references, if one of
            them has more pixels than the first render, are provided as ``read_fine_photo`` as well.

    Raises:
        InputError: there are no renders or no references, the sizes of render, photo or depth differ, or a render or
            every reference has no camera in ``cameras``.
    """
    root = Path(renders)
    files = images_by_stem(root)
    truth_photos = images_by_stem(Path(photos)) if photos is not None else {}
    cameras_file = Path(cameras or "")
    named_cameras = cameras_by_stem(read_cameras(cameras_file), cameras_file) if cameras is not None else None
    depths = Path(depth) if depth is not None else None
    if depths is not None and not depths.is_dir():
        raise InputError(depths, "is no folder", "name the folder of depth maps")
    targets = []
    for stem, path in files.items():
        depth_reader = _depth_of(depths, stem, path, depth_scale, needed=True)
        camera = _camera_of(named_cameras, stem, path, cameras_file)
        photo = truth_photos.get(stem)
        targets.append(_view(path, photo, depth_reader, None, camera, background, finer, resizes_photo=True))
    if isinstance(references, Scene):
        reference_views = _references(references)
    else:
        candidates = list_images(Path(references)) if references is not None else list(truth_photos.values())
        reference_files = [path for path in candidates if references is not None or path.stem not in files]
        reference_views = tuple(_reference(p, named_cameras, depths, depth_scale, background) for p in reference_files)
        if named_cameras is not None and reference_views and not any(view.camera for view in reference_views):
            received = f"names no camera for any photo, {reference_views[0].name} among them"
            raise InputError(cameras_file, received, "add them or leave cameras out")
    if finer and any(_is_larger(view, targets[0]) for view in reference_views):
        reference_views = tuple(replace(view, read_fine_photo=view.read_photo) for view in reference_views)
    if not reference_views:
        if photos is None:
            remedy = "name a folder of the capture's photos with photos= or references="
            raise InputError(root, "comes without photos", remedy)
        run, step = _run_of(root)
        if run is None or not run_steps(run, "train"):
            received = f"leaves no photo to refer to: {photos} holds the renders' own photos alone"
            remedy = "name a folder of the capture's other photos with references="
            raise InputError(root, received, remedy if run is None else f"{remedy}, or run={run} {_scene_options(run)}")
        of_run = read_run(run, step, background=background, name=name)
        has_depth_of_run = depths is None or (depths.resolve(), depth_scale) == (root.resolve().parent / "depth", 1)
        return replace(
            of_run,
            targets=tuple(_complete(*views) for views in zip(targets, of_run.targets, strict=True)),
            references=tuple(
                _training_view(view, named_cameras, depths, depth_scale, cameras_file) for view in of_run.references
            ),
            own_depth=of_run.own_depth and has_depth_of_run and cameras is None,
        )
    return RenderedSet(name or root.resolve().name, tuple(targets), reference_views, background)


def _scene_options(run: Path) -> str:
    """Options that name the capture of a 3DGS run, as found in ``cfg_args``."""
    arguments = run / "cfg_args"
    match = re.search(r"source_path='([^']+)'", read_text(arguments)) if arguments.is_file() else None
    return f"scene=capture scene.path={match[1] if match else 'CAPTURE'}"


def _run_of(renders: Path) -> tuple[Path | None, int]:
    """Run folder and step of a folder of held-out renders, derived from its path; (None, 0) if it lies in no run."""
    renders = renders.resolve()
    match = re.fullmatch(r"ours_(\d+)", renders.parent.name)
    if renders.name != "renders" or match is None or renders.parents[1].name != "test":
        return None, 0
    return renders.parents[2], int(match[1])


def _stems(side: Path) -> list[str]:
    return list(images_by_stem(side / "renders"))


def _match(
    cameras: tuple[ListedCamera, ...], test_stems: list[str], train_stems: list[str], source: Path
) -> tuple[dict[str, Camera], dict[str, Camera]]:
    """Cameras of the test and of the training renders, by stem; both empty if there are no cameras."""
    if not cameras:
        return {}, {}
    if all(entry.split is not None for entry in cameras):
        by_stem = cameras_by_stem(cameras, source)
        without_camera = [stem for stem in (*test_stems, *train_stems) if stem not in by_stem]
        if without_camera:
            received = f"lacks {len(without_camera)} cameras, first {without_camera[0]!r}"
            raise InputError(source, received, "write it again")
        return {stem: by_stem[stem] for stem in test_stems}, {stem: by_stem[stem] for stem in train_stems}
    expected = len(test_stems) + len(train_stems)
    if len(cameras) != expected and (train_stems or len(cameras) < expected):
        received = f"lists {len(cameras)} cameras for {len(test_stems)} test and {len(train_stems)} train renders"
        raise InputError(source, received, "use the cameras.json that was written with these renders")
    ordered_cameras = [entry.camera for entry in cameras]
    test_cameras = dict(zip(test_stems, ordered_cameras, strict=False))
    return test_cameras, dict(zip(train_stems, ordered_cameras[len(test_stems) :], strict=False))


def _read_split(side: Path, cameras: dict[str, Camera], background: Colour) -> tuple[RenderedView, ...]:
    """The views of a folder with ``renders`` and, where there are any, ``gt``, ``depth`` and ``alpha``."""
    folders = (side / name for name in ("gt", "depth", "alpha"))
    photos_folder, depths, alphas = (folder if folder.is_dir() else None for folder in folders)
    photos = {p.stem: p for p in list_images(photos_folder)} if photos_folder is not None else {}
    views = []
    for path in list_images(side / "renders"):
        if photos_folder is not None and path.stem not in photos:
            raise InputError(photos_folder, f"has no photo for the render {path.name}", "render the run again")
        depth = _depth_of(depths, path.stem, path, 1.0, needed=True)
        alpha = alphas / f"{path.stem}.png" if alphas is not None else None
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
    resizes_photo: bool = False,
) -> RenderedView:
    """One target with its photo, depth and alpha, which must have the render's size.

    A camera of another size but the same aspect ratio is resized, and with ``resizes_photo`` a photo too. With
    ``finer`` the photo may have 4 times the render's resolution.
    """
    header = read_header(render)
    size = header.size
    fine_reader, fine_size = None, None
    if photo is not None:
        photo_size = read_header(photo).size
        if finer and is_finer(photo_size, size):
            fine_reader = ReadPhoto(photo, UPSCALE * size[0], UPSCALE * size[1], background)
            fine_size = original_size(photo_size, size)
        elif not (resizes_photo and evenly_resized(photo_size, size)):
            _refuse_other_size(render, size, photo, photo_size)
    if depth is not None:
        _refuse_other_size(render, size, depth.path, depth_size(depth.path))
    if alpha is not None:
        _refuse_other_size(render, size, alpha, read_header(alpha).size)
    render_with_alpha = render if header.has_alpha else None
    coverage = alpha if alpha is not None else render_with_alpha
    return RenderedView(
        render.name,
        ReadPhoto(render, *size, background),
        _resize_camera(camera, size, render) if camera is not None else None,
        depth,
        ReadCoverage(coverage, *size) if coverage is not None else None,
        ReadPhoto(photo, *size, background) if photo is not None else None,
        fine_reader,
        fine_size,
    )


def _reference(
    path: Path,
    listed: dict[str, Camera] | None,
    depths: Path | None,
    scale: float,
    background: Colour,
) -> RenderedView:
    size = read_header(path).size
    depth = _depth_of(depths, path.stem, path, scale, needed=False)
    camera = None if listed is None else listed.get(path.stem)
    return RenderedView(
        path.name,
        None,
        _resize_camera(camera, size, path) if camera is not None else None,
        depth,
        None,
        ReadPhoto(path, *size, background),
    )


def _complete(target: RenderedView, of_run: RenderedView) -> RenderedView:
    """A target with the geometry of the same view of a run where none was given."""
    return replace(
        target,
        camera=target.camera or of_run.camera,
        read_depth=target.read_depth or of_run.read_depth,
        read_alpha=target.read_alpha or of_run.read_alpha,
    )


def _training_view(
    view: RenderedView, listed: dict[str, Camera] | None, depths: Path | None, scale: float, source: Path
) -> RenderedView:
    """A training view of a run, with the camera and depth that were given under its name instead of its own."""
    image = Path(view.name)
    camera = _camera_of(listed, image.stem, image, source)
    depth = _depth_of(depths, image.stem, image, scale, needed=False)
    if camera is not None:  # cameras of two files may lie in different worlds: all come from the given one
        assert isinstance(view.read_photo, ReadPhoto)
        camera = _resize_camera(camera, (view.read_photo.height, view.read_photo.width), image)
    return replace(view, camera=camera or view.camera, read_depth=depth or view.read_depth)


def _is_larger(reference: RenderedView, target: RenderedView) -> bool:
    """Whether a reference's photo has more pixels than a target's render, without decoding either."""
    photo, render = reference.camera or reference.read_photo, target.read
    if not isinstance(photo, Camera | ReadPhoto) or not isinstance(render, ReadPhoto):
        return False
    return photo.height * photo.width > render.height * render.width


def _rename_references(references: tuple[RenderedView, ...]) -> tuple[RenderedView, ...]:
    """Training views renamed to differ from the test views.

    3DGS numbers both splits from 0, and a view with the target's name is never chosen as its reference.
    """
    numbered_name = re.compile(r"\d{5}\.\w+")
    return tuple(
        replace(view, name=f"train_{view.name}") if numbered_name.fullmatch(view.name) else view for view in references
    )


def _references(capture: Scene | None) -> tuple[RenderedView, ...]:
    photos = capture.train_photos if capture is not None else ()
    return tuple(RenderedView(photo.name, None, photo.camera, read_photo=photo.read) for photo in photos)


def _refuse_other_size(render: Path, render_size: tuple[int, int], file: Path, size: tuple[int, int]) -> None:
    if size != render_size:
        received = f"is {size[1]}x{size[0]} but its render {render.name} is {render_size[1]}x{render_size[0]}"
        raise InputError(file, received, "bring both to the same size")


def _resize_camera(camera: Camera, size: tuple[int, int], image: Path) -> Camera:
    height, width = size
    if not evenly_resized(size, (camera.height, camera.width)):
        received = f"is {width}x{height} but its camera is {camera.width}x{camera.height}"
        raise InputError(image, received, "use the camera that it was rendered with")
    return camera.resized(height, width)


def _background(root: Path) -> Colour:
    """Background colour of a run by its ``cfg_args``: the colour that this project writes, else 3DGS's white or black.

    Raises:
        InputError: the colour is not three numbers from 0 to 1.
    """
    arguments = root / "cfg_args"
    content = read_text(arguments) if arguments.is_file() else ""
    number = r"(\d+(?:\.\d+)?(?:e-?\d+)?)"
    match = re.search(rf"\bbackground=\({number}, {number}, {number}\)", content)
    if match is not None:
        return background_colour([float(value) for value in match.groups()])
    return WHITE if "white_background=True" in content else BLACK
