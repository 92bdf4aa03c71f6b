"""Camera paths of procedural scenes.

Axes: c cameras.
"""

import numpy as np
from jaxtyping import Float

from gaussian_enhancer.scene.procedural.draft import CameraPath
from gaussian_enhancer.scene.procedural.vector import Vector

CameraPositions = tuple[Float[np.ndarray, "c 3"], Float[np.ndarray, "c 3"]]


def orbit(seed: int, target: Vector, radius: float, heights: tuple[float, float]) -> CameraPath:
    """Path of one turn round a subject, whose height varies sinusoidally, with random hand-held motion.

    Args:
        seed: seed of the random numbers.
        target: point that the cameras look at.
        radius: mean horizontal distance from the target, metres.
        heights: lowest and highest camera, metres.
    """
    wander = 0.12  # scale of the random motion of camera and target, metres

    def path(views: int) -> CameraPositions:
        rng = np.random.default_rng([seed, views, 1])
        t = np.arange(views) / views
        angle = 2 * np.pi * (t + rng.uniform())
        radii = (
            radius * (1 + 0.08 * np.sin(4 * np.pi * t + rng.uniform(0, 6.3))) + wander * rng.normal(size=views) * 0.5
        )
        wave = 0.5 + 0.5 * np.sin(2 * np.pi * (2 * t + rng.uniform()))
        z = heights[0] + (heights[1] - heights[0]) * wave + wander * rng.normal(size=views) * 0.4
        eye = np.stack(
            [target[0] + radii * np.cos(angle), target[1] + radii * np.sin(angle), np.maximum(z, 0.25)], axis=1
        )
        return eye, np.asarray(target) + wander * rng.normal(size=(views, 3))

    return path


def hemisphere(seed: int, target: Vector, radius: float) -> CameraPath:
    """Cameras distributed evenly over the upper hemisphere, as in NeRF-Synthetic, ordered along an upward spiral."""

    def path(views: int) -> CameraPositions:
        rng = np.random.default_rng([seed, views, 2])
        t = (np.arange(views) + 0.5) / views
        up = np.clip(0.05 + 0.9 * t + 0.03 * rng.normal(size=views), 0.02, 0.97)
        angle = np.pi * (1 + 5**0.5) * np.arange(views) + rng.uniform(0, 6.3)
        ring = np.sqrt(1 - up**2)
        directions = np.stack([ring * np.cos(angle), ring * np.sin(angle), up], axis=1)
        return np.asarray(target) + radius * directions, np.tile(np.asarray(target, dtype=float), (views, 1))

    return path


def walk(seed: int, start: Vector, end: Vector, aim: tuple[Vector, Vector]) -> CameraPath:
    """Path along a line and back at another height and 1.1 m aside, looking at a point that moves along `aim`."""

    def path(views: int) -> CameraPositions:
        rng = np.random.default_rng([seed, views, 3])
        t = np.arange(views) / views
        fraction = (1 - np.abs(2 * t - 1))[:, None]
        eye = np.asarray(start) * (1 - fraction) + np.asarray(end) * fraction
        returning = (t > 0.5).astype(float)
        eye = eye + np.stack(
            [0 * t, -1.1 * returning + 0.25 * np.sin(9 * t), 0.45 * returning + 0.1 * np.sin(14 * t)], axis=1
        )
        targets = np.asarray(aim[0]) * (1 - fraction) + np.asarray(aim[1]) * fraction
        return eye + 0.03 * rng.normal(size=eye.shape), targets + 0.25 * rng.normal(size=eye.shape) * [1, 1, 0.5]

    return path


def room(seed: int, size: tuple[float, float], inset: float, heights: tuple[float, float]) -> CameraPath:
    """Elliptical path inside a room; the cameras look across it."""

    def path(views: int) -> CameraPositions:
        rng = np.random.default_rng([seed, views, 4])
        t = np.arange(views) / views
        angle = 2 * np.pi * (t + rng.uniform())
        semi_axis_x, semi_axis_y = size[0] / 2 - inset, size[1] / 2 - inset
        z = heights[0] + (heights[1] - heights[0]) * (0.5 + 0.5 * np.sin(6 * np.pi * t + rng.uniform(0, 6)))
        eye = np.stack(
            [semi_axis_x * np.cos(angle), semi_axis_y * np.sin(angle), z + 0.03 * rng.normal(size=views)], axis=1
        )
        target_angle = angle + np.pi + 0.35 * np.sin(2 * angle + rng.uniform(0, 6))
        targets = np.stack(
            [0.6 * semi_axis_x * np.cos(target_angle), 0.6 * semi_axis_y * np.sin(target_angle), 0 * t + 0.85], axis=1
        )
        return eye, targets + 0.1 * rng.normal(size=targets.shape)

    return path


def mole(
    seed: int, centre: Vector, radius: float, sweep: tuple[float, float], heights: tuple[float, float]
) -> CameraPath:
    """Path along an arc and back at a smaller radius and another height; the viewing direction swings about the centre.

    Args:
        seed: seed of the random hand-held motion.
        centre: centre of the arc, about which the viewing direction swings.
        radius: radius on the way out, metres; 0.9 m smaller on the way back.
        sweep: first and last angle, radians.
        heights: camera heights on the way out and on the way back, metres.
    """

    def path(views: int) -> CameraPositions:
        rng = np.random.default_rng([seed, views, 5])
        t = np.arange(views) / views
        returning = (t > 0.5).astype(float)
        angle = sweep[0] + (sweep[1] - sweep[0]) * (1 - np.abs(2 * t - 1)) + 0.02 * rng.normal(size=views)
        radii = radius - 0.9 * returning + 0.15 * np.sin(11 * t)
        z = heights[0] + (heights[1] - heights[0]) * returning + 0.08 * rng.normal(size=views)
        eye = np.stack([centre[0] + radii * np.cos(angle), centre[1] + radii * np.sin(angle), z], axis=1)
        sideways = 2.4 * np.sin(7 * np.pi * t + rng.uniform(0, 6.3))
        targets = np.stack([centre[0] + sideways, centre[1] + 0 * t, np.full(views, centre[2])], axis=1)
        return eye, targets + 0.2 * rng.normal(size=targets.shape) * [1, 1, 0.5]

    return path
