"""Outdoor lighting at random times of day: sky, sun, haze and exposure."""

import numpy as np
from jaxtyping import Float

from gaussian_enhancer.scene.procedural.draft import Draft, LightSpec, SkySpec
from gaussian_enhancer.scene.procedural.textures import clouds
from gaussian_enhancer.scene.procedural.vector import Vector

_SKIES: tuple[tuple[Vector, Vector, Vector, float], ...] = (
    # zenith, horizon, sun colour, elevation in degrees
    ((0.20, 0.36, 0.72), (0.62, 0.74, 0.88), (2.3, 2.1, 1.85), 48.0),
    ((0.30, 0.42, 0.66), (0.78, 0.76, 0.72), (2.2, 1.75, 1.25), 26.0),
    ((0.52, 0.58, 0.66), (0.72, 0.75, 0.78), (0.75, 0.74, 0.72), 55.0),
    ((0.26, 0.40, 0.70), (0.70, 0.74, 0.80), (1.7, 1.6, 1.45), 38.0),
)


def towards(elevation: float, azimuth: float) -> Float[np.ndarray, " 3"]:
    """Unit vector towards an elevation above the horizon in degrees and an azimuth from +x in radians."""
    angle = np.deg2rad(elevation)
    return np.array([np.cos(angle) * np.cos(azimuth), np.cos(angle) * np.sin(azimuth), np.sin(angle)])


def daylight(draft: Draft, radius: float) -> None:
    """Add a cloudy sky and a sun to a draft; the sun's shadow map covers `radius` metres about the origin."""
    rng = draft.rng
    zenith, horizon, sun_colour, elevation = _SKIES[int(rng.integers(len(_SKIES)))]
    sun_direction = towards(elevation + rng.uniform(-7, 7), rng.uniform(0, 2 * np.pi))
    ground = tuple(0.28 * np.array(horizon) + 0.10 * np.array(sun_colour) * np.array([1.0, 0.95, 0.85]))
    cloud_texture = draft.texture(clouds(rng))
    draft.sky = SkySpec(zenith, horizon, ground, cloud_texture, tuple(sun_direction))
    position = tuple(sun_direction * 60 * radius)
    draft.lights.append(LightSpec(position, (0.0, 0.0, 0.0), radius, sun_colour))
    draft.haze = 0.0006 * rng.uniform(0.3, 1.6)
    draft.exposure = float(rng.uniform(0.85, 1.1))
