"""Camera paths for videos: through the cameras of a capture, round what they look at, and in a spiral before it.

Axes: c cameras, p path cameras.
"""

import dataclasses
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.path import short_tour, smooth_path
from gaussian_enhancer.typed import check_fields
from gaussian_enhancer.types import Camera

Shape = Literal["interpolate", "orbit", "spiral"]
OUTSIDE = 1.0
"""A path camera may be at most this many times the capture's width away from the nearest photo."""
PARALLEL = 1e-3
"""Smallest eigenvalue of the mean of I - d d^T, viewing directions d, at which they have a point in common."""
IN_FRONT = 0.75
"""Share of the cameras that must have the point that they look at before them."""
AROUND = 0.5
"""Length of the mean viewing direction below which cameras look all around."""
FAR = 10.0
"""Distance, in widths of the capture, of the point that a spiral looks at where viewing directions are parallel."""


@dataclass(frozen=True)
class PathSettings:
    """How a path is laid through or round the cameras of a capture.

    Args:
        frames: number of path cameras.
        cameras: of "interpolate": how many of the capture's cameras the path passes, evenly chosen along a short tour;
            None passes all.
        turns: of "orbit" and "spiral": full turns. A whole number of an orbit's, an even one of a spiral's turns, ends
            where it began.
        radius: of "orbit" and "spiral": times the median distance, and times the spread, of the capture's cameras.

    Raises:
        InputError: a number is out of range.
    """

    frames: Annotated[int, Field(ge=2, le=1_000_000)] = 240
    cameras: Annotated[int, Field(ge=2)] | None = 16
    turns: Annotated[int | float, Field(gt=0)] | None = None
    radius: Annotated[int | float, Field(gt=0)] = 1.0

    def __post_init__(self) -> None:
        check_fields(self, "")


def capture_path(shape: Shape, cameras: Sequence[Camera], settings: PathSettings) -> tuple[Camera, ...]:
    """A path by a capture's cameras. All of its cameras have one lens, `common_lens`.

    Args:
        shape: "interpolate": through the cameras, in the order of a short tour, at even speed. "orbit": a circle round
            the point that the cameras look at, at their median distance and height. "spiral": a spiral about the mean
            camera that looks at one point, as LLFF renders forward-facing captures (Mildenhall et al., 2019).
        cameras: of the capture, in its order.
        settings: of the path.

    Raises:
        InputError: there are fewer than two cameras, or they do not look at one point, as an orbit and a spiral need.
    """
    if len(cameras) < 2:
        received = f"is laid by the cameras of a capture, which has {len(cameras)}"
        raise InputError(f"path={shape}", received, "give a capture of more photos, or a file with the path")
    lens = common_lens(cameras)
    if shape == "interpolate":
        return _interpolated(cameras, lens, settings)
    return _orbit(cameras, lens, settings) if shape == "orbit" else _spiral(cameras, lens, settings)


def common_lens(cameras: Sequence[Camera]) -> Camera:
    """A camera of the most common size with the median intrinsics of the cameras of that size; its pose is the first's.

    Args:
        cameras: of a capture.
    """
    (height, width), _ = Counter((camera.height, camera.width) for camera in cameras).most_common(1)[0]
    alike = [camera for camera in cameras if (camera.height, camera.width) == (height, width)]
    K = torch.from_numpy(np.median(np.stack([camera.K.cpu().double().numpy() for camera in alike]), axis=0))
    return dataclasses.replace(alike[0], K=K.to(alike[0].K))


def resize_to_even(cameras: Sequence[Camera], height: int | None = None) -> tuple[Camera, ...]:
    """The cameras at a height in pixels, without the last row and column where a side is odd: videos have even sides.

    Args:
        cameras: of a path, all of one size.
        height: of the frames; None keeps the cameras'.

    Raises:
        InputError: cameras differ in size, or a side is below 2 pixels.
    """
    sizes = dict.fromkeys((camera.width, camera.height) for camera in cameras)
    if len(sizes) > 1:
        sizes_text = " and ".join(f"{width}x{height}" for width, height in list(sizes)[:3])
        raise InputError("camera path", f"has cameras of {sizes_text}", "give all frames one size")
    if height is not None:
        cameras = [camera.resized(height, round(camera.width * height / camera.height)) for camera in cameras]
    if min(cameras[0].height, cameras[0].width) < 2:
        received = f"has frames of {cameras[0].width}x{cameras[0].height} pixels"
        raise InputError("camera path", received, "give frames of at least 2x2 pixels")
    return tuple(dataclasses.replace(c, height=c.height // 2 * 2, width=c.width // 2 * 2) for c in cameras)


def refuse_outside(path: Sequence[Camera], cameras: Sequence[Camera], subject: object) -> None:
    """Refuse a path that leaves the space of the capture, where a splat knows nothing.

    Args:
        path: cameras of the path.
        cameras: cameras of the capture.
        subject: what the path is called, in the error.

    Raises:
        InputError: a camera is farther from the nearest of the capture's than the capture is wide.
    """
    photos = _centres(cameras)
    width = 2 * float(np.linalg.norm(photos - photos.mean(0), axis=1).max())
    distances = np.stack([np.linalg.norm(photos - centre, axis=1).min() for centre in _centres(path)])
    worst = int(distances.argmax())
    if width > 0 and distances[worst] > OUTSIDE * width:
        received = f"leaves the capture: camera {worst + 1} of {len(path)} is {distances[worst] / width:.1f} times the "
        received += "capture's width away from the nearest photo"
        raise InputError(subject, received, "give a path in the capture's own coordinates, near its photos")


def _interpolated(cameras: Sequence[Camera], lens: Camera, settings: PathSettings) -> tuple[Camera, ...]:
    tour = [cameras[i] for i in short_tour(cameras)]
    count = len(tour) if settings.cameras is None else min(settings.cameras, len(tour))
    passed = [tour[round(i)] for i in np.linspace(0, len(tour) - 1, count)]
    alike = [dataclasses.replace(lens, world_to_camera=camera.world_to_camera) for camera in passed]
    return smooth_path(alike, settings.frames, even_speed=True)


def _orbit(cameras: Sequence[Camera], lens: Camera, settings: PathSettings) -> tuple[Camera, ...]:
    centres, up = _centres(cameras), _up(cameras, "orbit")
    focus = _focus(cameras)
    if focus is None:
        raise InputError("path=orbit", "has no centre: the cameras do not look at one point", "use path=interpolate")
    heights = (centres - focus) @ up
    aside = centres - focus - heights[:, None] * up
    distance = settings.radius * float(np.median(np.linalg.norm(aside, axis=1)))
    if not distance > 0:
        raise InputError("path=orbit", "has no radius: the cameras stand above one another", "use path=interpolate")
    first = aside[np.linalg.norm(aside, axis=1).argmax()]
    first = first / np.linalg.norm(first)
    angles = 2 * np.pi * (settings.turns or 1) * np.arange(settings.frames) / settings.frames
    ring = np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * np.cross(up, first)
    eyes = focus + settings.radius * float(np.median(heights)) * up + distance * ring
    return tuple(_look_at(lens, eye, focus, up, "orbit") for eye in eyes)


def _spiral(cameras: Sequence[Camera], lens: Camera, settings: PathSettings) -> tuple[Camera, ...]:
    centres, up = _centres(cameras), _up(cameras, "spiral")
    mean, forward = centres.mean(0), np.stack([c.forward.double().cpu().numpy() for c in cameras]).mean(0)
    if np.linalg.norm(forward) < AROUND:
        raise InputError("path=spiral", "has no front: the cameras look all around", "use path=orbit or interpolate")
    forward = forward / np.linalg.norm(forward)
    spread = float(np.linalg.norm(centres - mean, axis=1).max())
    focus = _focus(cameras)
    ahead = 0.0 if focus is None else float((focus - mean) @ forward)
    target = mean + (ahead if ahead > 0 else FAR * spread) * forward
    right = np.cross(forward, up)
    axes = np.stack([right / np.linalg.norm(right), np.cross(forward, right) / np.linalg.norm(right), forward])
    radii = settings.radius * np.percentile(np.abs((centres - mean) @ axes.T), 90, axis=0)
    if not radii.any():
        raise InputError("path=spiral", "has no radius: the cameras stand at one place", "use path=interpolate")
    angles = 2 * np.pi * (settings.turns or 2) * np.arange(settings.frames) / settings.frames
    waves = np.stack([np.cos(angles), -np.sin(angles), -np.sin(angles / 2)], axis=1)
    return tuple(_look_at(lens, eye, target, up, "spiral") for eye in mean + (waves * radii) @ axes)


def _centres(cameras: Sequence[Camera]) -> Float[np.ndarray, "c 3"]:
    return np.stack([camera.centre.double().cpu().numpy() for camera in cameras])


def _up(cameras: Sequence[Camera], shape: str) -> Float[np.ndarray, " 3"]:
    """The mean of the cameras' upward directions."""
    up = -np.stack([camera.rotation[1].double().cpu().numpy() for camera in cameras]).mean(0)
    if np.linalg.norm(up) < 1e-3:
        raise InputError(f"path={shape}", "has no upward direction: the cameras' cancel", "use path=interpolate")
    return up / np.linalg.norm(up)


def _focus(cameras: Sequence[Camera]) -> Float[np.ndarray, " 3"] | None:
    """The point nearest to all viewing rays (least squares); None where they are parallel or it is not before them."""
    centres = _centres(cameras)
    forward = np.stack([camera.forward.double().cpu().numpy() for camera in cameras])
    across = np.eye(3) - forward[:, :, None] * forward[:, None, :]
    normal = across.mean(0)
    if np.linalg.eigvalsh(normal)[0] < PARALLEL:
        return None
    point = np.linalg.solve(normal, (across @ centres[:, :, None]).mean(0)[:, 0])
    before = ((point - centres) * forward).sum(1) > 0
    return point if before.mean() >= IN_FRONT else None


def _look_at(
    lens: Camera, eye: Float[np.ndarray, " 3"], target: Float[np.ndarray, " 3"], up: Float[np.ndarray, " 3"], shape: str
) -> Camera:
    """A camera of a lens at a place that looks at a point, upright."""
    forward = target - eye
    right = np.cross(forward, up)
    if not np.linalg.norm(right) > 1e-6 * np.linalg.norm(forward):
        raise InputError(f"path={shape}", "looks straight up or down", "give another radius, or use path=interpolate")
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ eye
    return dataclasses.replace(lens, world_to_camera=torch.from_numpy(pose).to(lens.world_to_camera))
