"""Smooth camera path through the cameras of a capture, for videos.

Axes: c cameras, p path cameras.
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, RotationSpline

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import Camera

DENSE = 64
"""Samples per camera from which the arc length of the path is computed."""


def smooth_path(cameras: Sequence[Camera], frames: int, *, even_speed: bool = False) -> tuple[Camera, ...]:
    """Cameras along a smooth curve that passes through the given cameras, including the first and the last.

    Centres follow a centripetal Catmull-Rom spline (Yuksel et al., Parameterization and Applications of Catmull-Rom
    Curves, CAD 2011), which has neither cusps nor loops. Rotations follow a spline of continuous angular acceleration
    (scipy's `RotationSpline`) over the same times. Intrinsics are interpolated linearly. The time between two
    consecutive cameras is the square root of their separation: the distance between centres, in units of its mean over
    the path, plus the rotation angle in radians. This limits the variation of speed between near and distant cameras.

    Args:
        cameras: cameras that the path passes through, in this order, all of one size.
        frames: number of cameras on the path, at least 2.
        even_speed: place frames at equal arc lengths, measured as the separation above, instead of at equal times.

    Raises:
        InputError: there are fewer than 2 cameras or frames, or the cameras differ in size.
    """
    if len(cameras) < 2 or frames < 2:
        received = f"has {len(cameras)} cameras for {frames} frames"
        raise InputError("camera path", received, "give at least 2 cameras and 2 frames")
    sizes = dict.fromkeys((camera.width, camera.height) for camera in cameras)
    if len(sizes) > 1:
        sizes_text = " and ".join(f"{width}x{height}" for width, height in sizes)
        raise InputError("camera path", f"passes cameras of {sizes_text}", "resize them to one size")
    centres = np.stack([camera.centre.double().cpu().numpy() for camera in cameras])
    rotations = Rotation.from_matrix(np.stack([camera.rotation.T.double().cpu().numpy() for camera in cameras]))
    intrinsics = np.stack([camera.K.double().cpu().numpy() for camera in cameras])
    times = _times(centres, rotations)
    centre_at = CubicHermiteSpline(times, centres, _velocities(times, centres))
    rotation_at = RotationSpline(times, rotations)
    sample_times = np.linspace(0.0, times[-1], frames)
    if even_speed:
        dense_times = np.linspace(0.0, times[-1], DENSE * len(cameras))
        dense_steps = _movements(centre_at(dense_times), rotation_at(dense_times), _mean_step(centres))
        arc_length = np.concatenate([[0.0], np.cumsum(dense_steps)])
        sample_times = np.interp(np.linspace(0.0, arc_length[-1], frames), arc_length, dense_times)
    path_centres = centre_at(sample_times)
    path_rotations = rotation_at(sample_times).inv().as_matrix()
    K = np.stack([np.interp(sample_times, times, column) for column in intrinsics.reshape(len(cameras), 9).T], axis=1)
    return tuple(_camera(cameras[0], K[i].reshape(3, 3), path_rotations[i], path_centres[i]) for i in range(frames))


def _times(centres: Float[np.ndarray, "c 3"], rotations: Rotation) -> Float[np.ndarray, " c"]:
    """Time at which the path passes each camera; consecutive times differ by at least 1/1000 of the mean difference."""
    steps = np.sqrt(_movements(centres, rotations, _mean_step(centres)))
    smallest_step = 1e-3 * steps.mean() if steps.any() else 1.0
    return np.concatenate([[0.0], np.cumsum(np.maximum(steps, smallest_step))])


def _mean_step(centres: Float[np.ndarray, "c 3"]) -> float:
    """Mean distance between consecutive centres; 1 where all coincide."""
    mean = float(np.linalg.norm(np.diff(centres, axis=0), axis=1).mean())
    return mean if mean > 0 else 1.0


def _movements(centres: Float[np.ndarray, "c 3"], rotations: Rotation, unit: float) -> Float[np.ndarray, " c-1"]:
    """Separation of consecutive cameras: distance divided by ``unit`` plus rotation angle in radians."""
    angles = (rotations[1:] * rotations[:-1].inv()).magnitude()
    return np.linalg.norm(np.diff(centres, axis=0), axis=1) / unit + angles


def _velocities(times: Float[np.ndarray, " c"], centres: Float[np.ndarray, "c 3"]) -> Float[np.ndarray, "c 3"]:
    """Catmull-Rom tangents: of the parabola through each centre and its two neighbours; of the chord at both ends."""
    slopes = np.diff(centres, axis=0) / np.diff(times)[:, None]
    intervals_before, intervals_after = np.diff(times)[:-1, None], np.diff(times)[1:, None]
    inner = (slopes[:-1] * intervals_after + slopes[1:] * intervals_before) / (intervals_before + intervals_after)
    return np.concatenate([slopes[:1], inner, slopes[-1:]])


def _camera(like: Camera, K: np.ndarray, rotation: np.ndarray, centre: np.ndarray) -> Camera:
    """A camera of the same size, data type and device as ``like``."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ centre
    return Camera(torch.from_numpy(K).to(like.K), torch.from_numpy(pose).to(like.K), like.height, like.width)


def short_tour(cameras: Sequence[Camera]) -> tuple[int, ...]:
    """A short tour of the cameras: their order improved by 2-opt until reversing any segment no longer shortens it.

    A video's frames keep their order. Photos in no order, along which a path would cross the subject, are sorted into a
    tour from neighbour to neighbour that is near the shortest. The length of a step is the
    distance, in units of the median distance between consecutive cameras, plus the rotation angle in radians. The tour
    is open: it does not return to its start.

    Args:
        cameras: cameras in the capture's order.

    Returns:
        Indices of the cameras in the order of the tour.
    """
    if len(cameras) < 3:
        return tuple(range(len(cameras)))
    centres = torch.stack([camera.centre for camera in cameras]).double()
    rotations = torch.stack([camera.rotation for camera in cameras]).double()
    distance = (centres[:, None] - centres[None]).norm(dim=-1)
    unit = distance.diagonal(1).median()
    cosine = ((rotations[:, None] * rotations[None]).sum((-1, -2)) - 1) / 2
    steps = (distance / (unit if unit > 0 else 1.0) + cosine.clamp(-1, 1).arccos()).numpy()
    np.fill_diagonal(steps, 0.0)
    return tuple(_untangle(steps))


def _untangle(steps: Float[np.ndarray, "c c"]) -> list[int]:
    """2-opt of an open tour, started from the order 0, 1, 2, ...; each iteration applies the best reversal."""
    order = np.arange(len(steps))
    while True:
        ordered_steps = steps[order][:, order]
        # Length of the step into and out of each position; the first has no step into it, the last none out of it.
        step_into = np.concatenate([[0.0], ordered_steps.diagonal(1)])
        step_out = np.concatenate([ordered_steps.diagonal(1), [0.0]])
        # Entry [i, j] of a change: by how much the length changes if positions i to j are reversed.
        change_at_start = np.vstack([np.zeros(len(order)), ordered_steps[:-1]]) - step_into[:, None]
        change_at_end = np.hstack([ordered_steps[:, 1:], np.zeros((len(order), 1))]) - step_out[None]
        change = np.triu(change_at_start + change_at_end, 1)
        if change.min() > -1e-9:
            return [int(index) for index in order]
        i, j = np.unravel_index(change.argmin(), change.shape)
        order[i : j + 1] = order[i : j + 1][::-1]
