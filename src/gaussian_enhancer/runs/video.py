"""Reads the camera path, its enhancer and the output settings from the configuration of the job ``video``."""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import get_args

import torch
from omegaconf import DictConfig, open_dict

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import file_digest
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.path_references import PathReferences
from gaussian_enhancer.infer.validated_inputs import ValidatedInputs
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.runs import enhancement
from gaussian_enhancer.runs.arguments import refuse_without_effect
from gaussian_enhancer.runs.enhancement import prepare_enhancement, read_options
from gaussian_enhancer.runs.inputs import Task, attach_fine, refuse_input_folder, with_fine_photos
from gaussian_enhancer.runs.path_surfaces import refuse_inside
from gaussian_enhancer.runs.splat_source import open_splat_with_capture, splat_file
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
from gaussian_enhancer.splat.io.result_folders import find_splat
from gaussian_enhancer.types import Camera
from gaussian_enhancer.video.clip import Clip
from gaussian_enhancer.video.encode import CODECS, Encoding
from gaussian_enhancer.video.frames import frame_name
from gaussian_enhancer.video.layout import Layout

SHAPES: tuple[Shape, ...] = get_args(Shape)
PATH_OPTIONS = {"interpolate": ("cameras",), "orbit": ("turns", "radius"), "spiral": ("turns", "radius")}
"""The options of each shape; a path from a file has none of them."""
FRAMES, FPS = 240, 30.0
FORMATS = (*CODECS, "frames")
SHAPE_TOLERANCE = 0.02
"""Permitted relative difference of aspect ratio between a clip's frames and its cameras, since sides are rounded."""
PRESENTATION_KEYS = ("format", "layout", "wipe", "fps", "quality")
"""Keys that change only how frames are presented. Other values of them reuse the frames that exist."""


@dataclass(frozen=True)
class CameraPath:
    """The cameras of a video.

    Args:
        name: short name, used in folders.
        cameras: one camera for each frame, all of one size with even sides.
        fps: frame rate that the path's file or the clip states; None if neither states one.
        clip: a video rendered along the path, whose frames replace the splat's renders.
    """

    name: str
    cameras: tuple[Camera, ...]
    fps: float | None = None
    clip: Clip | None = None

    @property
    def count(self) -> int:
        """Number of frames. A clip's frames without a camera come after those with one."""
        return len(self.cameras) if self.clip is None else self.clip.count

    @property
    def note(self) -> str:
        """A remark on the path for the user; empty if there is none."""
        without_camera = self.count - len(self.cameras)
        return (
            f"{without_camera} of {self.count} frames of the input have no camera and stay as they are"
            if without_camera
            else ""
        )


@dataclass(frozen=True)
class VideoTask:
    """A video to enhance: its frames, the references and the enhancer.

    Args:
        cfg: configuration of the job ``video``.
        path: cameras of the frames.
        enhancer: enhancer of the frames.
        task: the frames as targets, and the references.
        validated: the validated inputs.
    """

    cfg: DictConfig
    path: CameraPath
    enhancer: SetEnhancer
    task: Task
    validated: ValidatedInputs


@dataclass(frozen=True)
class VideoOutput:
    """Format and location of the written frames.

    Args:
        encoding: encoding of a video; None writes images.
        layout: which images a frame shows, and how they are arranged.
        destination: the file, or the folder of images; None for the folder of the run.
        sound: a video whose sound is copied; None for no sound.
    """

    encoding: Encoding | None
    layout: Layout
    destination: Path | None
    sound: Path | None = None


def read_output(cfg: DictConfig, path: CameraPath | None = None) -> VideoOutput:
    """Read the output settings. Settings that would fail after the computation are refused here.

    Args:
        cfg: configuration of the job ``video``.
        path: the camera path, if it is known.

    Raises:
        InputError: an option is out of range, the encoder is missing, or the output cannot be written under its name.
    """
    output = None if cfg.output is None else Path(cfg.output)
    extension = "" if output is None else output.suffix.lower().removeprefix(".")
    output_format = cfg.format if cfg.format is not None else extension if extension in CODECS else "mp4"
    if output_format not in FORMATS:
        raise InputError("format", f"is {output_format!r}", f"choose {', '.join(FORMATS)}")
    layout = Layout(cfg.layout, cfg.wipe)
    if output_format == "frames":
        if output is not None and output.is_file():
            raise InputError(output, "cannot be written: it is a file", "name a folder")
        for side in ("test", "train"):
            if output is not None and cfg.run and output.resolve().is_relative_to((Path(cfg.run) / side).resolve()):
                raise InputError(output, "holds images of the input", "name another folder")
        return VideoOutput(None, layout, output)
    if output is not None and output.is_dir():
        raise InputError(output, "cannot be written: it is a folder", f"name a file that ends in .{output_format}")
    if output is not None and extension != output_format:
        received = f"does not end in .{output_format}, which is the format"
        raise InputError(output, received, f"name it .{output_format}, or give format={' or '.join(FORMATS)}")
    path_fps, clip = (None, None) if path is None else (path.fps, path.clip)
    if output is not None and clip is not None and output.resolve() == clip.path.resolve():
        raise InputError(output, "is the input itself", "name another file")
    fps = cfg.fps if cfg.fps is not None else path_fps or FPS
    encoding = Encoding(output_format, fps, cfg.quality)
    encoding.check(() if clip is None else clip.sound)
    return VideoOutput(encoding, layout, output, clip.path if clip is not None and clip.sound else None)


def prepare_video(cfg: DictConfig, device: torch.device) -> VideoTask:
    """Compute the path, read the splat, load the weights and validate the input.

    Args:
        cfg: configuration of the job ``video``.
        device: device of the rendering and of the network.

    Raises:
        InputError: the input cannot be read, the path or the weights do not exist, the output folder holds files of the
            input, or an option is out of range.
    """
    pretrained = load_weights(cfg.weights)
    path, task = read_path_task(cfg, device.type, pretrained.reference_config.fine)
    if cfg.output:
        refuse_input_folder(Path(cfg.output), task.rendered)
    enhancer, task, validated = prepare_enhancement(pretrained, task, read_options(cfg), device)
    references = PathReferences.from_config(validated.reference_config)
    enhancer.reference_config = references
    return VideoTask(cfg, path, enhancer, task, replace(validated, reference_config=references))


def load_video(cfg: DictConfig, device: torch.device) -> tuple[SetEnhancer, Task, ValidatedInputs]:
    """The enhancer, the task and the validated inputs of `prepare_video`, whose run time `apply_budget` measures."""
    video = prepare_video(cfg, device)
    return video.enhancer, video.task, video.validated


def read_path_task(cfg: DictConfig, device: str, fine: bool) -> tuple[CameraPath, Task]:
    """Create the path, its frames as targets that are rendered when they are read, and the photos as references.

    Args:
        cfg: configuration of the job ``video``.
        device: "cpu" or "cuda", for rendering the splat.
        fine: attach photos at 4 times the renders' resolution where they are available.

    Raises:
        InputError: no splat or several were given, the input cannot be read, or the path cannot be computed.
    """
    capture = open_splat_with_capture(cfg, "video")
    path = compute_path(cfg, capture.cameras)
    renderer = capture.renderer(cfg, device)
    refuse_inside(path.cameras, capture.cameras, renderer, f"path={cfg.path}")
    rendered = capture.references_rendered_by(renderer)
    task = Task(rendered, depth="surface" if device == "cpu" else "expected")
    task = with_fine_photos(task, partial(attach_fine, cfg) if fine else None)
    targets = tuple(renderer.target(f"path {frame_name(i)}", camera) for i, camera in enumerate(path.cameras))
    if path.clip is not None:
        targets = tuple(replace(view, read=partial(path.clip.frame, i)) for i, view in enumerate(targets))
    return path, replace(task, rendered=replace(task.rendered, targets=targets, own_depth=True))


def compute_path(cfg: DictConfig, cameras: Sequence[Camera]) -> CameraPath:
    """Compute the camera path that a configuration describes.

    Args:
        cfg: configuration of the job ``video``.
        cameras: cameras of the capture, in its order.

    Raises:
        InputError: the path does not exist, it cannot be computed, or it leaves the capture.
    """
    shape_or_file, subject, height = str(cfg.path), f"path={cfg.path}", cfg.height
    if height is not None and not 2 <= height <= 16384:
        raise InputError("height", f"is {height}", "give pixels from 2 to 16384, or null")
    name, fps = shape_or_file, None
    changed = [key for key in ("cameras", "turns", "radius") if cfg[key] != getattr(PathSettings(), key)]
    refuse_without_effect((key for key in changed if key not in PATH_OPTIONS.get(shape_or_file, ())), subject)
    clip = None if cfg.input is None else _open_clip(cfg)
    path_cameras: Sequence[Camera]
    if shape_or_file in SHAPES:
        frame_count = FRAMES if cfg.frames is None else cfg.frames
        path_cameras = capture_path(
            shape_or_file, cameras, PathSettings(frame_count, cfg.cameras, cfg.turns, cfg.radius)
        )
    else:
        lens = common_lens(cameras)
        file = read_path(shape_or_file, lens.height, lens.width)
        path_cameras, fps, name = file.cameras, file.fps, re.sub(r"[^\w-]+", "_", Path(shape_or_file).stem) or "path"
        if cfg.frames is not None:
            path_cameras = smooth_path(path_cameras, PathSettings(cfg.frames).frames, even_speed=True)
    refuse_outside(path_cameras, cameras, subject)
    if clip is None:
        return CameraPath(name, resize_to_even(path_cameras, height), fps)
    _refuse_other_path(clip, path_cameras, shape_or_file)
    return CameraPath(name, tuple(camera.resized(clip.height, clip.width) for camera in path_cameras), clip.fps, clip)


def _open_clip(cfg: DictConfig) -> Clip:
    """Open the video whose frames are enhanced.

    Raises:
        InputError: the video cannot be read, or options contradict it.
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
    """Refuse cameras that do not belong to a video: more than its frames, or of another aspect ratio."""
    remedy, aspect_ratio = "give the path that it was rendered along", cameras[0].width / cameras[0].height
    if len(cameras) > clip.count:
        raise InputError(clip.path, f"has {clip.count} frames for {len(cameras)} cameras of {file}", remedy)
    if abs(clip.width / clip.height / aspect_ratio - 1) > SHAPE_TOLERANCE:
        received = f"has frames of {clip.width}x{clip.height} for cameras of {cameras[0].width}x{cameras[0].height}"
        raise InputError(clip.path, received, remedy)


def naming_configuration(video: VideoTask) -> DictConfig:
    """Configuration that names the run's folder: all that frames depend on, with a digest of each file's content.

    Args:
        video: the video to enhance.
    """
    cfg, configuration = video.cfg, enhancement.naming_configuration(video.cfg)
    splat = splat_file(cfg.run) if cfg.run is not None else find_splat(cfg.gaussians)
    digests = {"path": _path_digest(video.path.cameras), "splat": file_digest(splat)}
    if video.path.clip is not None:
        digests["input"] = file_digest(video.path.clip.path)
    with open_dict(configuration):
        for name in (*PRESENTATION_KEYS, "input"):  # the input is identified by its content
            configuration.pop(name, None)
        configuration.update({"output": None, "made_of": digests})
    return configuration


def _path_digest(cameras: Sequence[Camera]) -> str:
    digest = hashlib.sha256()
    for camera in cameras:
        digest.update(camera.K.cpu().numpy().tobytes() + camera.world_to_camera.cpu().numpy().tobytes())
        digest.update(f"{camera.height}x{camera.width}".encode())
    return digest.hexdigest()
