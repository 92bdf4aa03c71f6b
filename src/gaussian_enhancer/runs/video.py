"""From the configuration of the job ``video`` to the frames of a path, what enhances them, and how they are written."""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import get_args

import torch
from jaxtyping import Float
from omegaconf import DictConfig, open_dict
from torch import Tensor

from gaussian_enhancer.checkpoint import find_checkpoint
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.path_references import PathReferences
from gaussian_enhancer.infer.validated_inputs import ValidatedInputs
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.runs.enhancement import effective_options, options_of, prepare_enhancement
from gaussian_enhancer.runs.inputs import InputPaths, Task, attach_fine
from gaussian_enhancer.runs.path_surfaces import refuse_inside
from gaussian_enhancer.runs.splat_source import find_splat_file, open_capture, splat_file
from gaussian_enhancer.scene.camera_path import (
    PathSettings,
    Shape,
    capture_path,
    common_lens,
    refuse_outside,
    resize_to_even,
)
from gaussian_enhancer.scene.path import smooth_path
from gaussian_enhancer.scene.path_files import read_path
from gaussian_enhancer.types import Camera
from gaussian_enhancer.video.clip import Clip
from gaussian_enhancer.video.encode import CODECS, Encoding
from gaussian_enhancer.video.frames import frame_name
from gaussian_enhancer.video.layout import Layout

SHAPES: tuple[Shape, ...] = get_args(Shape)
FRAMES, FPS = 240, 30.0
FORMATS = (*CODECS, "frames")
SHAPE_TOLERANCE = 0.02
"""How far the shape of a clip's frames may differ from that of its cameras: sides are rounded."""
SHOWN = ("format", "layout", "wipe", "fps", "quality")
"""Keys that change how frames are shown and not what they are: another choice uses the frames that are there."""


@dataclass(frozen=True)
class CameraPath:
    """The cameras of a video.

    Args:
        name: short name, used in folders.
        cameras: one a frame, all of one size with even sides.
        fps: frames a second that the path's file, or the clip, states; None where neither does.
        clip: a video rendered along the path, whose frames take the place of the splat's renders.
    """

    name: str
    cameras: tuple[Camera, ...]
    fps: float | None = None
    clip: Clip | None = None

    @property
    def count(self) -> int:
        """Frames of the video; those of a clip that have no camera follow those that have one."""
        return len(self.cameras) if self.clip is None else self.clip.count

    def frame(self, index: int) -> Float[Tensor, "3 h w"]:
        """A frame of the clip.

        Args:
            index: 0 for the first.

        Raises:
            InputError: there is none.
        """
        if self.clip is None:
            raise InputError(f"frame {index}", "is of no clip", "give input=VIDEO")
        return self.clip.frame(index)

    @property
    def note(self) -> str:
        """What a user must know of the path; empty where there is nothing."""
        left = self.count - len(self.cameras)
        return f"{left} of {self.count} frames of the input have no camera and stay as they are" if left else ""


@dataclass(frozen=True)
class Filmed:
    """What a video is made of.

    Args:
        cfg: configuration of the job ``video``.
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
class VideoOutput:
    """How and where frames are written.

    Args:
        encoding: of a video; None writes images.
        layout: what a frame shows.
        place: the file, or for images the folder; None for the run's own folder.
        sound: a video whose sound is copied; None where there is none.
    """

    encoding: Encoding | None
    layout: Layout
    place: Path | None
    sound: Path | None = None


def read_output(cfg: DictConfig, path: CameraPath | None = None) -> VideoOutput:
    """How frames are written; whatever would fail at the end fails here.

    Args:
        cfg: configuration of the job ``video``.
        path: what is filmed, where it is known.

    Raises:
        InputError: an option is out of range, the encoder is missing, or the output cannot be written under its name.
    """
    output = None if cfg.output is None else Path(cfg.output)
    ending = "" if output is None else output.suffix.lower().removeprefix(".")
    chosen = cfg.format if cfg.format is not None else ending if ending in CODECS else "mp4"
    if chosen not in FORMATS:
        raise InputError("format", f"is {chosen!r}", f"choose {', '.join(FORMATS)}")
    layout = Layout(cfg.layout, cfg.wipe)
    if chosen == "frames":
        if output is not None and output.is_file():
            raise InputError(output, "cannot be written: it is a file", "name a folder")
        return VideoOutput(None, layout, output)
    if output is not None and output.is_dir():
        raise InputError(output, "cannot be written: it is a folder", f"name a file that ends in .{chosen}")
    if output is not None and ending != chosen:
        received = f"does not end in .{chosen}, which is the format"
        raise InputError(output, received, f"name it .{chosen}, or give format={' or '.join(FORMATS)}")
    stated, clip = (None, None) if path is None else (path.fps, path.clip)
    encoding = Encoding(chosen, cfg.fps if cfg.fps is not None else stated or FPS, cfg.quality)
    encoding.check(() if clip is None else clip.sound)
    return VideoOutput(encoding, layout, output, clip.path if clip is not None and clip.sound else None)


def prepare_film(cfg: DictConfig, device: torch.device) -> Filmed:
    """Lay the path, open what renders it, load the weights and validate the input.

    Args:
        cfg: configuration of the job ``video``.
        device: where the splat is rendered and the network runs.

    Raises:
        InputError: the input cannot be read, there is no such path, weights are missing, or an option is out of range.
    """
    pretrained = load_weights(cfg.weights)
    path, task = read_path_task(cfg, device.type, pretrained.reference_config.fine)
    enhancer, task, validated = prepare_enhancement(pretrained, task, options_of(cfg), device)
    references = PathReferences.from_config(validated.reference_config)
    enhancer.reference_config = references
    return Filmed(cfg, path, enhancer, task, replace(validated, reference_config=references))


def load_film(cfg: DictConfig, device: torch.device) -> tuple[SetEnhancer, Task, ValidatedInputs]:
    """What `within_budget` measures: see `prepare_film`."""
    filmed = prepare_film(cfg, device)
    return filmed.enhancer, filmed.task, filmed.found


def read_path_task(cfg: DictConfig, device: str, fine: bool) -> tuple[CameraPath, Task]:
    """The path, its frames as targets that are rendered when they are read, and the capture's photos as references.

    Args:
        cfg: configuration of the job ``video``.
        device: "cpu" or "cuda", where the splat is rendered.
        fine: attach photos 4 times as fine as the renders where they are known.

    Raises:
        InputError: no splat or several were given, the input cannot be read, or the path cannot be laid.
    """
    capture = open_capture(cfg, "video")
    path = lay_path(cfg, capture.cameras)
    renderer = capture.renderer(cfg, device)
    refuse_inside(path.cameras, capture.cameras, renderer, f"path={cfg.path}")
    rendered = capture.references_rendered_by(renderer)
    task = Task(rendered, depth="surface" if device == "cpu" else "expected")
    task = InputPaths(attach_fine=partial(attach_fine, cfg)).with_fine_photos(task, fine)
    targets = tuple(renderer.target(f"path {frame_name(i)}", camera) for i, camera in enumerate(path.cameras))
    if path.clip is not None:
        targets = tuple(replace(view, read=partial(path.frame, i)) for i, view in enumerate(targets))
    return path, replace(task, rendered=replace(task.rendered, targets=targets, own_depth=True))


def lay_path(cfg: DictConfig, cameras: Sequence[Camera]) -> CameraPath:
    """The path of a configuration.

    Args:
        cfg: configuration of the job ``video``.
        cameras: of the capture, in its order.

    Raises:
        InputError: there is no such path, it cannot be laid, or it leaves the capture.
    """
    asked, subject, height = str(cfg.path), f"path={cfg.path}", _whole_number(cfg, "height")
    name, fps, clip = asked, None, None if cfg.input is None else _clip(cfg)
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
    if clip is None:
        return CameraPath(name, resize_to_even(laid, height), fps)
    _refuse_other_path(clip, laid, asked)
    return CameraPath(name, tuple(camera.resized(clip.height, clip.width) for camera in laid), clip.fps, clip)


def _clip(cfg: DictConfig) -> Clip:
    """The video whose frames are enhanced.

    Raises:
        InputError: it cannot be read, or options contradict it.
    """
    extra_keys = [key for key in ("frames", "height", "fps") if cfg[key] is not None]
    if extra_keys:
        raise InputError(extra_keys[0], "is given, and the input states it", f"leave out {extra_keys[0]}")
    if str(cfg.path) in SHAPES:
        received = f"comes with path={cfg.path}, which is not how it was rendered"
        raise InputError("input", received, "give path=FILE with the cameras of its frames")
    clip = Clip(cfg.input)
    if clip.height % 2 or clip.width % 2:
        raise InputError(clip.path, f"has frames of {clip.width}x{clip.height}", "give a video of even sides")
    return clip


def _refuse_other_path(clip: Clip, cameras: Sequence[Camera], file: str) -> None:
    """Refuse cameras that a video cannot have been rendered with: more than its frames, or of another shape."""
    remedy, shape = "give the path that it was rendered along", cameras[0].width / cameras[0].height
    if len(cameras) > clip.count:
        raise InputError(clip.path, f"has {clip.count} frames for {len(cameras)} cameras of {file}", remedy)
    if abs(clip.width / clip.height / shape - 1) > SHAPE_TOLERANCE:
        received = f"has frames of {clip.width}x{clip.height} for cameras of {cameras[0].width}x{cameras[0].height}"
        raise InputError(clip.path, received, remedy)


def run_configuration(filmed: Filmed) -> DictConfig:
    """The configuration from which the run's folder gets its name: what frames depend on, files by their content.

    Args:
        filmed: what the video is made of.
    """
    cfg, kept = filmed.cfg, effective_options(filmed.cfg)
    splat = splat_file(cfg.run) if cfg.run is not None else find_splat_file(cfg.gaussians)
    made_of = {"path": _path_digest(filmed.path.cameras), "splat": file_digest(splat)}
    if filmed.path.clip is not None:
        made_of["input"] = file_digest(filmed.path.clip.path)
    with open_dict(kept):
        for name in (*SHOWN, "input"):  # the content of the input counts
            kept.pop(name, None)
        kept.update({"output": None, "made_of": {**made_of, "weights": file_digest(find_checkpoint(cfg.weights))}})
    return kept


def file_digest(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal digits.

    Args:
        path: the file.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _whole_number(cfg: DictConfig, key: str) -> int | None:
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
