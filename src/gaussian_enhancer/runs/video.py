"""From the configuration of the job ``video`` to the frames of a path, what enhances them, and how they are written."""

import copy
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import get_args

import torch
from omegaconf import DictConfig, open_dict

from gaussian_enhancer.checkpoint import find_checkpoint
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.path_references import PathReferences
from gaussian_enhancer.infer.validated_inputs import ValidatedInputs
from gaussian_enhancer.infer.weights import Pretrained, load_weights
from gaussian_enhancer.runs.enhancement import options_of, prepared, with_effect
from gaussian_enhancer.runs.inputs import InputPaths, Task, attach_fine
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.rendered_capture import SplatRenderer, open_renderer
from gaussian_enhancer.scene.camera_path import (
    PathSettings,
    Shape,
    capture_path,
    common_lens,
    even_sized,
    refuse_outside,
)
from gaussian_enhancer.scene.path import smooth_path
from gaussian_enhancer.scene.path_files import read_path
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.types import Camera
from gaussian_enhancer.video.encode import CODECS, Encoding
from gaussian_enhancer.video.frames import frame_name
from gaussian_enhancer.video.layout import Layout

SHAPES: tuple[Shape, ...] = get_args(Shape)
FRAMES, FPS = 240, 30.0
SMOOTHING = 0.5
"""Share of the change that a frame takes over from the frame before, unless it is given."""
FORMATS = (*CODECS, "frames")
SHOWN = ("format", "layout", "wipe", "fps", "quality")
"""Keys that change how frames are shown and not what they are: another choice uses the frames that are there."""


@dataclass(frozen=True)
class CameraPath:
    """The cameras of a video.

    Args:
        name: short name, used in folders.
        cameras: one a frame, all of one size with even sides.
        fps: frames a second that the path's file states; None where it does not.
    """

    name: str
    cameras: tuple[Camera, ...]
    fps: float | None = None


@dataclass(frozen=True)
class Filmed:
    """What a video is made of.

    Args:
        cfg: configuration of the job ``video``; what was left to the weights is decided.
        path: its cameras.
        enhancer: what enhances its frames.
        task: its frames as targets, and the references.
        found: what of the input is used.
    """

    cfg: DictConfig
    path: CameraPath
    enhancer: SetEnhancer
    task: Task
    found: ValidatedInputs


@dataclass(frozen=True)
class Output:
    """How and where frames are written.

    Args:
        encoding: of a video; None writes images.
        layout: what a frame shows.
        place: the file, or for images the folder; None for the run's own folder.
    """

    encoding: Encoding | None
    layout: Layout
    place: Path | None


def read_output(cfg: DictConfig, fps: float | None = None) -> Output:
    """How frames are written; whatever would fail at the end fails here.

    Args:
        cfg: configuration of the job ``video``.
        fps: frames a second that the path's file states.

    Raises:
        InputError: an option is out of range, the encoder is missing, or the output cannot be written under its name.
    """
    place = None if cfg.output is None else Path(cfg.output)
    ending = "" if place is None else place.suffix.lower().removeprefix(".")
    chosen = cfg.format if cfg.format is not None else ending if ending in CODECS else "mp4"
    if chosen not in FORMATS:
        raise InputError("format", f"is {chosen!r}", f"choose {', '.join(FORMATS)}")
    layout = Layout(cfg.layout, cfg.wipe)
    if chosen == "frames":
        if place is not None and place.is_file():
            raise InputError(place, "cannot be written: it is a file", "name a folder")
        return Output(None, layout, place)
    if place is not None and place.is_dir():
        raise InputError(place, "cannot be written: it is a folder", f"name a file that ends in .{chosen}")
    if place is not None and ending != chosen:
        received = f"does not end in .{chosen}, which is the format"
        raise InputError(place, received, f"name it .{chosen}, or give format={' or '.join(FORMATS)}")
    rate = cfg.fps if cfg.fps is not None else FPS if fps is None else fps
    encoding = Encoding(chosen, rate, cfg.quality)
    encoding.check()
    return Output(encoding, layout, place)


def film(cfg: DictConfig, device: torch.device) -> Filmed:
    """Lay the path, open what renders it, load the weights and validate the input.

    Args:
        cfg: configuration of the job ``video``.
        device: where the splat is rendered and the network runs.

    Raises:
        InputError: the input cannot be read, there is no such path, weights are missing, or an option is out of range.
    """
    pretrained = load_weights(cfg.weights)
    path, task = read_path_task(cfg, device.type, pretrained.reference_config.fine)
    cfg = _with_smoothing(cfg, pretrained)
    enhancer, task, found = prepared(pretrained, task, options_of(cfg), device)
    references = PathReferences.of(found.reference_config)
    enhancer.reference_config = references
    return Filmed(cfg, path, enhancer, task, replace(found, reference_config=references))


def ready(cfg: DictConfig, device: torch.device) -> tuple[SetEnhancer, Task, ValidatedInputs]:
    """What `within_budget` measures: see `film`."""
    found = film(cfg, device)
    return found.enhancer, found.task, found.found


def read_path_task(cfg: DictConfig, device: str, fine: bool) -> tuple[CameraPath, Task]:
    """The path, its frames as targets that are rendered when they are read, and the capture's photos as references.

    Args:
        cfg: configuration of the job ``video``.
        device: "cpu" or "cuda", where the splat is rendered.
        fine: attach photos 4 times as fine as the renders where they are known.

    Raises:
        InputError: no splat or several were given, the input cannot be read, or the path cannot be laid.
    """
    given = [name for name in ("run", "gaussians") if cfg[name] is not None]
    if len(given) != 1:
        received = f"was given {' and '.join(given)}" if given else "was given nothing to render"
        raise InputError("video", received, "give one of run=FOLDER, gaussians=FILE with scene=...")
    path, renderer, rendered = _of_run(cfg, device) if cfg.run is not None else _of_splat(cfg, device)
    task = Task(rendered, depth="surface" if device == "cpu" else "expected")
    task = InputPaths(attach_fine=partial(attach_fine, cfg)).with_fine_photos(task, fine)
    targets = tuple(renderer.target(f"path {frame_name(i)}", camera) for i, camera in enumerate(path.cameras))
    return path, replace(task, rendered=replace(task.rendered, targets=targets, own_depth=True))


def lay_path(cfg: DictConfig, cameras: Sequence[Camera]) -> CameraPath:
    """The path of a configuration.

    Args:
        cfg: configuration of the job ``video``.
        cameras: of the capture, in its order.

    Raises:
        InputError: there is no such path, it cannot be laid, or it leaves the capture.
    """
    asked, subject, height = str(cfg.path), f"path={cfg.path}", _whole(cfg, "height")
    name, fps = asked, None
    laid: Sequence[Camera]
    if asked in SHAPES:
        frames = FRAMES if cfg.frames is None else cfg.frames
        laid = capture_path(asked, cameras, PathSettings(frames, cfg.cameras, cfg.turns, cfg.radius))
    else:
        lens = common_lens(cameras)
        file = read_path(asked, lens.height, lens.width)
        laid, fps, name = file.cameras, file.fps, re.sub(r"[^\w-]+", "_", Path(asked).stem) or "path"
        if cfg.frames is not None:
            laid = smooth_path(laid, PathSettings(cfg.frames).frames, even_speed=True)
    refuse_outside(laid, cameras, subject)
    return CameraPath(name, even_sized(laid, height), fps)


def splat_file(run: str | Path) -> Path:
    """The splat of a run's folder: of this project's, or of original 3DGS output at its latest iteration.

    Args:
        run: the folder.

    Raises:
        InputError: it holds no splat.
    """
    own = Path(run) / "splat.ply"
    if own.is_file():
        return own
    others = {
        int(found[1]): path
        for path in Path(run).glob("point_cloud/iteration_*/point_cloud.ply")
        if (found := re.fullmatch(r"iteration_(\d+)", path.parent.name))
    }
    if not others:
        received = "holds neither splat.ply nor point_cloud/iteration_*/point_cloud.ply"
        raise InputError(run, received, "name a run's folder, or give gaussians=FILE with scene=...")
    return others[max(others)]


def run_configuration(filmed: Filmed) -> DictConfig:
    """The configuration from which the run's folder gets its name: what frames depend on, files by their content.

    Args:
        filmed: what the video is made of.
    """
    cfg, kept = filmed.cfg, with_effect(filmed.cfg)
    splat = splat_file(cfg.run) if cfg.run is not None else Path(cfg.gaussians)
    made_of = {"path": _path_digest(filmed.path.cameras), "splat": _file_digest(splat)}
    with open_dict(kept):
        for name in SHOWN:
            kept.pop(name, None)
        kept.update({"output": None, "made_of": {**made_of, "weights": _file_digest(find_checkpoint(cfg.weights))}})
    return kept


def _of_run(cfg: DictConfig, device: str) -> tuple[CameraPath, SplatRenderer, RenderedSet]:
    rendered = read_run(cfg.run)
    splat = splat_file(cfg.run)
    views = sorted((*rendered.targets, *rendered.references), key=lambda view: view.name)
    cameras = [view.camera for view in views if view.camera is not None]
    if len(cameras) < len(views):
        raise InputError(cfg.run, "has views without a camera", "give gaussians=FILE with scene=... instead")
    path = lay_path(cfg, cameras)
    training = [view.camera for view in rendered.references if view.camera is not None]
    renderer = open_renderer(splat, training, rendered.background, cfg.method, device, cfg.invalid)
    return path, renderer, rendered


def _of_splat(cfg: DictConfig, device: str) -> tuple[CameraPath, SplatRenderer, RenderedSet]:
    if not cfg.get("scene"):
        raise InputError("gaussians", "comes without its capture", "add scene=capture scene.path=FOLDER")
    capture: Scene = build(cfg.scene)
    cameras = [photo.camera for photo in capture.photos if photo.camera is not None]
    if len(cameras) < len(capture.photos):
        raise InputError(capture.name, "has photos without a camera", "give a capture with cameras")
    path = lay_path(cfg, cameras)
    training = [photo.camera for photo in capture.train_photos if photo.camera is not None]
    renderer = open_renderer(cfg.gaussians, training, capture.background, cfg.method, device, cfg.invalid)
    references = tuple(map(renderer.reference, capture.train_photos))
    return path, renderer, RenderedSet(capture.name, (), references, capture.background, own_depth=True)


def _with_smoothing(cfg: DictConfig, pretrained: Pretrained) -> DictConfig:
    """The configuration with a number for temporal smoothing, which super-resolution does not support."""
    if cfg.temporal_smoothing is not None:
        return cfg
    decided = copy.deepcopy(cfg)
    decided.temporal_smoothing = SMOOTHING if pretrained.network.scale == 1 else 0.0
    return decided


def _whole(cfg: DictConfig, key: str) -> int | None:
    value = cfg[key]
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int) or not 2 <= value <= 16384:
        raise InputError(key, f"is {value!r}", "give pixels from 2 to 16384, or null")
    return value


def _path_digest(cameras: Sequence[Camera]) -> str:
    content = hashlib.sha256()
    for camera in cameras:
        content.update(camera.K.cpu().numpy().tobytes() + camera.world_to_camera.cpu().numpy().tobytes())
        content.update(f"{camera.height}x{camera.width}".encode())
    return content.hexdigest()


def _file_digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
