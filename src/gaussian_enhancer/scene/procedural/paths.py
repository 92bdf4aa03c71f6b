"""Camera paths of procedural scenes.

Axes: c cameras.
"""

import numpy as np
from jaxtyping import Float

from gaussian_enhancer.scene.procedural.draft import CameraPath, Vector

Places = tuple[Float[np.ndarray, "c 3"], Float[np.ndarray, "c 3"]]


def orbit(
    seed: int, target: Vector, radius: float, heights: tuple[float, float], turns: float = 1.0, wander: float = 0.12
) -> CameraPath:
    """Round the subject, up and down by waves, hand-held: radius and aim vary by `wander` metres."""

    def path(views: int) -> Places:
        rng = np.random.default_rng([seed, views, 1])
        t = np.arange(views) / views
        angle = 2 * np.pi * (turns * t + rng.uniform())
        r = radius * (1 + 0.08 * np.sin(4 * np.pi * t + rng.uniform(0, 6.3))) + wander * rng.normal(size=views) * 0.5
        wave = 0.5 + 0.5 * np.sin(2 * np.pi * (2 * t + rng.uniform()))
        z = heights[0] + (heights[1] - heights[0]) * wave + wander * rng.normal(size=views) * 0.4
        eye = np.stack([target[0] + r * np.cos(angle), target[1] + r * np.sin(angle), np.maximum(z, 0.25)], axis=1)
        return eye, np.asarray(target) + wander * rng.normal(size=(views, 3))

    return path


def hemisphere(seed: int, target: Vector, radius: float) -> CameraPath:
    """Evenly over the upper hemisphere, as in NeRF-Synthetic, in an order that spirals upwards."""

    def path(views: int) -> Places:
        rng = np.random.default_rng([seed, views, 2])
        t = (np.arange(views) + 0.5) / views
        up = np.clip(0.05 + 0.9 * t + 0.03 * rng.normal(size=views), 0.02, 0.97)
        angle = np.pi * (1 + 5**0.5) * np.arange(views) + rng.uniform(0, 6.3)
        ring = np.sqrt(1 - up**2)
        directions = np.stack([ring * np.cos(angle), ring * np.sin(angle), up], axis=1)
        return np.asarray(target) + radius * directions, np.tile(np.asarray(target, dtype=float), (views, 1))

    return path


def walk(seed: int, start: Vector, end: Vector, aim: tuple[Vector, Vector], sway: float = 0.25) -> CameraPath:
    """Along a line and back at another height, looking to a point that moves along `aim`."""

    def path(views: int) -> Places:
        rng = np.random.default_rng([seed, views, 3])
        t = np.arange(views) / views
        along = (1 - np.abs(2 * t - 1))[:, None]
        eye = np.asarray(start) * (1 - along) + np.asarray(end) * along
        back = (t > 0.5).astype(float)
        eye = eye + np.stack([0 * t, -1.1 * back + sway * np.sin(9 * t), 0.45 * back + 0.1 * np.sin(14 * t)], axis=1)
        look = np.asarray(aim[0]) * (1 - along) + np.asarray(aim[1]) * along
        return eye + 0.03 * rng.normal(size=eye.shape), look + 0.25 * rng.normal(size=eye.shape) * [1, 1, 0.5]

    return path


def room(seed: int, size: tuple[float, float], inset: float, heights: tuple[float, float]) -> CameraPath:
    """An ellipse inside a room, looking across it."""

    def path(views: int) -> Places:
        rng = np.random.default_rng([seed, views, 4])
        t = np.arange(views) / views
        angle = 2 * np.pi * (t + rng.uniform())
        x, y = size[0] / 2 - inset, size[1] / 2 - inset
        z = heights[0] + (heights[1] - heights[0]) * (0.5 + 0.5 * np.sin(6 * np.pi * t + rng.uniform(0, 6)))
        eye = np.stack([x * np.cos(angle), y * np.sin(angle), z + 0.03 * rng.normal(size=views)], axis=1)
        across = angle + np.pi + 0.35 * np.sin(2 * angle + rng.uniform(0, 6))
        look = np.stack([0.6 * x * np.cos(across), 0.6 * y * np.sin(across), 0 * t + 0.85], axis=1)
        return eye, look + 0.1 * rng.normal(size=look.shape)

    return path


def mole(
    seed: int, centre: Vector, radius: float, sweep: tuple[float, float], heights: tuple[float, float]
) -> CameraPath:
    """Along an arc and back nearer and at another height, looking over its centre to either side.

    Args:
        seed: of the hand's unsteadiness.
        centre: of the arc, and what is looked at.
        radius: of the way out, metres.
        sweep: first and last angle, radians.
        heights: of the way out and of the way back.
    """

    def path(views: int) -> Places:
        rng = np.random.default_rng([seed, views, 5])
        t = np.arange(views) / views
        back = (t > 0.5).astype(float)
        angle = sweep[0] + (sweep[1] - sweep[0]) * (1 - np.abs(2 * t - 1)) + 0.02 * rng.normal(size=views)
        r = radius - 0.9 * back + 0.15 * np.sin(11 * t)
        z = heights[0] + (heights[1] - heights[0]) * back + 0.08 * rng.normal(size=views)
        eye = np.stack([centre[0] + r * np.cos(angle), centre[1] + r * np.sin(angle), z], axis=1)
        aside = 2.4 * np.sin(7 * np.pi * t + rng.uniform(0, 6.3))
        look = np.stack([centre[0] + aside, centre[1] + 0 * t, np.full(views, centre[2])], axis=1)
        return eye, look + 0.2 * rng.normal(size=look.shape) * [1, 1, 0.5]

    return path
