"""Camera paths for videos: through a capture's cameras, on an orbit around their focus, or on a spiral in front of it.

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
from gaussian_enhancer.scene.camera_geometry import focus_point, mean_up
from gaussian_enhancer.scene.path import short_tour, smooth_path
from gaussian_enhancer.typed import check_fields
from gaussian_enhancer.types import Camera

Shape = Literal["interpolate", "orbit", "spiral"]
MAX_DISTANCE = 1.0
"""Maximum distance of a path camera from the nearest photo's camera, in widths of the capture."""
PARALLEL_EIGENVALUE = 1e-3
"""Viewing directions d count as parallel if the smallest eigenvalue of the mean of I - d d^T is below this."""
MIN_FRONT_SHARE = 0.75
"""Minimum share of the cameras in front of which their common focus must lie."""
MAX_MEAN_DIRECTION = 0.5
"""Cameras count as looking in all directions if the length of their mean viewing direction is below this."""
SPIRAL_FOCUS_DISTANCE = 10.0
"""Distance of a spiral's focus where there is no focus in front of the cameras, in units of the cameras' spread."""


@dataclass(frozen=True)
class PathSettings:
    """Settings of a camera path that is derived from the cameras of a capture.

    Args:
        frames: number of path cameras.
        cameras: for "interpolate": number of the capture's cameras that the path passes through, evenly chosen along a
            short tour; None uses all.
        turns: for "orbit" and "spiral": number of turns; None means 1 for an orbit and 2 for a spiral. An orbit is
            closed for a whole number of turns, a spiral for an even number.
        radius: for "orbit" and "spiral": factor on the path's size. At 1 an orbit has the median distance and height of
            the capture's cameras; a spiral has, on each axis, the 90th percentile of their offsets from the mean.

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
    """A camera path derived from a capture's cameras. All path cameras have the same lens, `common_lens`.

    Args:
        shape: "interpolate": through the cameras, in the order of a short tour, at constant speed. "orbit": a circle
            around the cameras' common focus, at their median distance and height. "spiral": a spiral around the mean
            camera that looks at one point, as LLFF renders forward-facing captures (Mildenhall et al., 2019).
        cameras: cameras of the capture, in its order.
        settings: settings of the path.

    Raises:
        InputError: there are fewer than two cameras, or they do not suit the shape. An orbit needs a common focus; a
            spiral needs cameras that do not look in all directions.
    """
    if len(cameras) < 2:
        received = f"is laid by the cameras of a capture, which has {len(cameras)}"
        raise InputError(f"path={shape}", received, "give a capture of more photos, or a file with the path")
    lens = common_lens(cameras)
    if shape == "interpolate":
        return _interpolate(cameras, lens, settings)
    return _orbit(cameras, lens, settings) if shape == "orbit" else _spiral(cameras, lens, settings)


def common_lens(cameras: Sequence[Camera]) -> Camera:
    """A camera of the most common size with the median intrinsics of the cameras of that size.

    Its pose is that of the first camera of that size.

    Args:
        cameras: cameras of a capture.
    """
    (height, width), _ = Counter((camera.height, camera.width) for camera in cameras).most_common(1)[0]
    same_size = [camera for camera in cameras if (camera.height, camera.width) == (height, width)]
    K = torch.from_numpy(np.median(np.stack([camera.K.cpu().double().numpy() for camera in same_size]), axis=0))
    return dataclasses.replace(same_size[0], K=K.to(same_size[0].K))


def resize_to_even(cameras: Sequence[Camera], height: int | None = None) -> tuple[Camera, ...]:
    """Resize cameras to a height in pixels and crop odd sides by one pixel, since videos need even sides.

    Args:
        cameras: cameras of a path, all of one size.
        height: height of the frames in pixels; None keeps the cameras' height.

    Raises:
        InputError: the cameras differ in size, or a side is below 2 pixels.
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
    """Refuse a path that leaves the space of the capture, where the splat is unconstrained by photos.

    Args:
        path: cameras of the path.
        cameras: cameras of the capture.
        subject: name of the path, for the error.

    Raises:
        InputError: the distance from a path camera to the nearest of the capture's cameras exceeds `MAX_DISTANCE` times
            the capture's width.
    """
    photo_centres = _centres(cameras)
    width = 2 * float(np.linalg.norm(photo_centres - photo_centres.mean(0), axis=1).max())
    distances = np.stack([np.linalg.norm(photo_centres - centre, axis=1).min() for centre in _centres(path)])
    farthest = int(distances.argmax())
    if width > 0 and distances[farthest] > MAX_DISTANCE * width:
        camera, distance = f"camera {farthest + 1} of {len(path)}", distances[farthest] / width
        received = (
            f"leaves the capture: {camera} is {distance:.1f} times the capture's width away from the nearest photo"
        )
        raise InputError(subject, received, "give a path in the capture's own coordinates, near its photos")


def _interpolate(cameras: Sequence[Camera], lens: Camera, settings: PathSettings) -> tuple[Camera, ...]:
    tour = [cameras[i] for i in short_tour(cameras)]
    count = len(tour) if settings.cameras is None else min(settings.cameras, len(tour))
    waypoints = [tour[round(i)] for i in np.linspace(0, len(tour) - 1, count)]
    waypoint_cameras = [dataclasses.replace(lens, world_to_camera=camera.world_to_camera) for camera in waypoints]
    return smooth_path(waypoint_cameras, settings.frames, even_speed=True)


def _orbit(cameras: Sequence[Camera], lens: Camera, settings: PathSettings) -> tuple[Camera, ...]:
    centres, up = _centres(cameras), _up(cameras, "orbit")
    focus = _focus(cameras)
    if focus is None:
        raise InputError("path=orbit", "has no centre: the cameras' optical axes do not meet", "use path=interpolate")
    heights = (centres - focus) @ up
    horizontal = centres - focus - heights[:, None] * up
    distance = settings.radius * float(np.median(np.linalg.norm(horizontal, axis=1)))
    if not distance > 0:
        raise InputError("path=orbit", "has no radius: the cameras are above one another", "use path=interpolate")
    start_direction = horizontal[np.linalg.norm(horizontal, axis=1).argmax()]
    start_direction = start_direction / np.linalg.norm(start_direction)
    angles = 2 * np.pi * (settings.turns or 1) * np.arange(settings.frames) / settings.frames
    ring = np.cos(angles)[:, None] * start_direction + np.sin(angles)[:, None] * np.cross(up, start_direction)
    eyes = focus + settings.radius * float(np.median(heights)) * up + distance * ring
    return tuple(_look_at(lens, eye, focus, up, "orbit") for eye in eyes)


def _spiral(cameras: Sequence[Camera], lens: Camera, settings: PathSettings) -> tuple[Camera, ...]:
    centres, up = _centres(cameras), _up(cameras, "spiral")
    mean, forward = centres.mean(0), np.stack([c.forward.double().cpu().numpy() for c in cameras]).mean(0)
    if np.linalg.norm(forward) < MAX_MEAN_DIRECTION:
        raise InputError("path=spiral", "has no front: the cameras look all around", "use path=orbit or interpolate")
    forward = forward / np.linalg.norm(forward)
    spread = float(np.linalg.norm(centres - mean, axis=1).max())
    focus = _focus(cameras)
    focus_distance = 0.0 if focus is None else float((focus - mean) @ forward)
    target = mean + (focus_distance if focus_distance > 0 else SPIRAL_FOCUS_DISTANCE * spread) * forward
    right = np.cross(forward, up)
    axes = np.stack([right / np.linalg.norm(right), np.cross(forward, right) / np.linalg.norm(right), forward])
    radii = settings.radius * np.percentile(np.abs((centres - mean) @ axes.T), 90, axis=0)
    if not radii.any():
        raise InputError("path=spiral", "has no radius: all cameras are at the same place", "use path=interpolate")
    angles = 2 * np.pi * (settings.turns or 2) * np.arange(settings.frames) / settings.frames
    offsets = np.stack([np.cos(angles), -np.sin(angles), -np.sin(angles / 2)], axis=1)
    return tuple(_look_at(lens, eye, target, up, "spiral") for eye in mean + (offsets * radii) @ axes)


def _centres(cameras: Sequence[Camera]) -> Float[np.ndarray, "c 3"]:
    return np.stack([camera.centre.double().cpu().numpy() for camera in cameras])


def _up(cameras: Sequence[Camera], shape: str) -> Float[np.ndarray, " 3"]:
    """Unit vector of the mean of the cameras' upward directions."""
    up = mean_up(cameras)
    if np.linalg.norm(up) < 1e-3:
        raise InputError(f"path={shape}", "has no upward direction: the cameras' cancel", "use path=interpolate")
    return up / np.linalg.norm(up)


def _focus(cameras: Sequence[Camera]) -> Float[np.ndarray, " 3"] | None:
    """Least-squares intersection of the viewing rays; None if these are parallel or it lies behind too many cameras."""
    focus = focus_point(cameras, PARALLEL_EIGENVALUE)
    if focus is None:
        return None
    point, depths = (values.numpy() for values in focus)
    return point if (depths > 0).mean() >= MIN_FRONT_SHARE else None


def _look_at(
    lens: Camera, eye: Float[np.ndarray, " 3"], target: Float[np.ndarray, " 3"], up: Float[np.ndarray, " 3"], shape: str
) -> Camera:
    """An upright camera at ``eye`` that looks at ``target``, with the intrinsics of ``lens``."""
    forward = target - eye
    right = np.cross(forward, up)
    if not np.linalg.norm(right) > 1e-6 * np.linalg.norm(forward):
        raise InputError(f"path={shape}", "looks straight up or down", "give another radius, or use path=interpolate")
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ eye
    return dataclasses.replace(lens, world_to_camera=torch.from_numpy(pose).to(lens.world_to_camera))
