"""A smooth camera path through the cameras of a capture, for sequences of frames.

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
"""Samples between two cameras by which the length of the way is measured."""


def smooth_path(cameras: Sequence[Camera], frames: int, *, even_speed: bool = False) -> tuple[Camera, ...]:
    """Cameras along a smooth curve through the given ones, the first and the last included.

    Centres follow a centripetal Catmull-Rom spline (Yuksel et al., Parameterization and Applications of Catmull-Rom
    Curves, CAD 2011), which has neither cusps nor loops; rotations a spline of continuous angular acceleration
    (scipy's `RotationSpline`) over the same times; intrinsics are linear between cameras. The time from one camera to
    the next is the root of how far apart they are, distance in mean steps plus angle in radians, so that frames
    neither crawl between near cameras nor leap between far ones.

    Args:
        cameras: what the path passes through, in this order, all of one size.
        frames: number of cameras on the path, at least 2.
        even_speed: take frames at even distances along the curve, in the same unit (distance in mean steps plus angle
            in radians), instead of at even times.

    Raises:
        InputError: there are fewer than 2 cameras or frames, or cameras differ in size.
    """
    if len(cameras) < 2 or frames < 2:
        raise InputError(
            "camera path", f"has {len(cameras)} cameras for {frames} frames", "give at least 2 cameras and 2 frames"
        )
    sizes = dict.fromkeys((camera.width, camera.height) for camera in cameras)
    if len(sizes) > 1:
        found = " and ".join(f"{width}x{height}" for width, height in sizes)
        raise InputError("camera path", f"passes cameras of {found}", "resize them to one size")
    centres = np.stack([camera.centre.double().cpu().numpy() for camera in cameras])
    turns = Rotation.from_matrix(np.stack([camera.rotation.T.double().cpu().numpy() for camera in cameras]))
    intrinsics = np.stack([camera.K.double().cpu().numpy() for camera in cameras])
    times = _times(centres, turns)
    centre_at, turn_at = CubicHermiteSpline(times, centres, _velocities(times, centres)), RotationSpline(times, turns)
    sample_times = np.linspace(0.0, times[-1], frames)
    if even_speed:
        dense = np.linspace(0.0, times[-1], DENSE * len(cameras))
        arc_length = np.concatenate(
            [[0.0], np.cumsum(_movements(centre_at(dense), turn_at(dense), _mean_step(centres)))]
        )
        sample_times = np.interp(np.linspace(0.0, arc_length[-1], frames), arc_length, dense)
    at = centre_at(sample_times)
    to_camera = turn_at(sample_times).inv().as_matrix()
    K = np.stack([np.interp(sample_times, times, column) for column in intrinsics.reshape(len(cameras), 9).T], axis=1)
    return tuple(_camera(cameras[0], K[i].reshape(3, 3), to_camera[i], at[i]) for i in range(frames))


def _times(centres: Float[np.ndarray, "c 3"], turns: Rotation) -> Float[np.ndarray, " c"]:
    """When the path passes each camera; two at the same place are passed a thousandth of a mean step apart."""
    steps = np.sqrt(_movements(centres, turns, _mean_step(centres)))
    least = 1e-3 * steps.mean() if steps.any() else 1.0
    return np.concatenate([[0.0], np.cumsum(np.maximum(steps, least))])


def _mean_step(centres: Float[np.ndarray, "c 3"]) -> float:
    """Mean distance from one centre to the next; 1 where all are at the same place."""
    mean = float(np.linalg.norm(np.diff(centres, axis=0), axis=1).mean())
    return mean if mean > 0 else 1.0


def _movements(centres: Float[np.ndarray, "c 3"], turns: Rotation, unit: float) -> Float[np.ndarray, " c-1"]:
    """From each camera to the next: distance in a unit plus angle in radians."""
    angles = (turns[1:] * turns[:-1].inv()).magnitude()
    return np.linalg.norm(np.diff(centres, axis=0), axis=1) / unit + angles


def _velocities(times: Float[np.ndarray, " c"], centres: Float[np.ndarray, "c 3"]) -> Float[np.ndarray, "c 3"]:
    """Catmull-Rom tangents: the parabola through each camera and its two neighbours, the chord at both ends."""
    slopes = np.diff(centres, axis=0) / np.diff(times)[:, None]
    before, after = np.diff(times)[:-1, None], np.diff(times)[1:, None]
    inner = (slopes[:-1] * after + slopes[1:] * before) / (before + after)
    return np.concatenate([slopes[:1], inner, slopes[-1:]])


def _camera(like: Camera, K: np.ndarray, rotation: np.ndarray, centre: np.ndarray) -> Camera:
    """A camera of the same size, type and device as another."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ centre
    return Camera(torch.from_numpy(K).to(like.K), torch.from_numpy(pose).to(like.K), like.height, like.width)


def short_tour(cameras: Sequence[Camera]) -> tuple[int, ...]:
    """The order of cameras given, untangled: exchanged by 2-opt until no reversal of a stretch shortens the way.

    A video's order stays as it is; photos taken at random, whose order would send a path through the subject, come
    near a tour from neighbour to neighbour. The length of a step is distance, in median steps of the given order, plus
    angle in radians. The way is open: neither end is tied to the other.

    Args:
        cameras: in the capture's order.

    Returns:
        Indices of the cameras in the order of the tour.
    """
    if len(cameras) < 3:
        return tuple(range(len(cameras)))
    centres = torch.stack([camera.centre for camera in cameras]).double()
    turns = torch.stack([camera.rotation for camera in cameras]).double()
    distance = (centres[:, None] - centres[None]).norm(dim=-1)
    unit = distance.diagonal(1).median()
    cosine = ((turns[:, None] * turns[None]).sum((-1, -2)) - 1) / 2
    steps = (distance / (unit if unit > 0 else 1.0) + cosine.clamp(-1, 1).arccos()).numpy()
    np.fill_diagonal(steps, 0.0)
    return tuple(_untangle(steps))


def _untangle(steps: Float[np.ndarray, "c c"]) -> list[int]:
    """2-opt of an open way from the order 0, 1, 2, ..., best reversal first."""
    order = np.arange(len(steps))
    while True:
        ordered = steps[order][:, order]
        before = np.concatenate(
            [[0.0], ordered.diagonal(1)]
        )  # the step that leads to each place; none leads to the first
        after = np.concatenate([ordered.diagonal(1), [0.0]])
        enters = np.vstack([np.zeros(len(order)), ordered[:-1]]) - before[:, None]  # [i, j]: places i to j are reversed
        leaves = np.hstack([ordered[:, 1:], np.zeros((len(order), 1))]) - after[None]
        change = np.triu(enters + leaves, 1)
        if change.min() > -1e-9:
            return [int(index) for index in order]
        i, j = np.unravel_index(change.argmin(), change.shape)
        order[i : j + 1] = order[i : j + 1][::-1]
