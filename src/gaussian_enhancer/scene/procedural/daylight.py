"""Times of day: matching sun, sky, ambient light and exposure."""

import numpy as np

from gaussian_enhancer.scene.procedural.draft import Draft, LightSpec, SkySpec, Vector
from gaussian_enhancer.scene.procedural.textures import clouds

_SKIES: tuple[tuple[Vector, Vector, Vector, float], ...] = (
    # zenith, horizon, sun colour, elevation in degrees
    ((0.20, 0.36, 0.72), (0.62, 0.74, 0.88), (2.3, 2.1, 1.85), 48.0),
    ((0.30, 0.42, 0.66), (0.78, 0.76, 0.72), (2.2, 1.75, 1.25), 26.0),
    ((0.52, 0.58, 0.66), (0.72, 0.75, 0.78), (0.75, 0.74, 0.72), 55.0),
    ((0.26, 0.40, 0.70), (0.70, 0.74, 0.80), (1.7, 1.6, 1.45), 38.0),
)


def daylight(draft: Draft, radius: float) -> None:
    """Give a draft a sky with clouds and a sun whose shadow map covers `radius` about the origin."""
    rng = draft.rng
    zenith, horizon, sun, elevation = _SKIES[int(rng.integers(len(_SKIES)))]
    height, turn = np.deg2rad(elevation + rng.uniform(-7, 7)), rng.uniform(0, 2 * np.pi)
    way = np.array([np.cos(height) * np.cos(turn), np.cos(height) * np.sin(turn), np.sin(height)])
    ground = tuple(0.28 * np.array(horizon) + 0.10 * np.array(sun) * np.array([1.0, 0.95, 0.85]))
    texture = draft.texture(clouds(rng))
    draft.sky = SkySpec(zenith, horizon, ground, texture, tuple(way))
    position = tuple(way * 60 * radius)
    draft.lights.append(LightSpec(position, (0.0, 0.0, 0.0), radius, sun))
    draft.haze = 0.0006 * rng.uniform(0.3, 1.6)
    draft.exposure = float(rng.uniform(0.85, 1.1))
