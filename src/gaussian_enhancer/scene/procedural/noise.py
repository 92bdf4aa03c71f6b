"""Seamless noise and random colours, from which textures are composed.

Axes: t texture side, g cells along a side, k angles.
"""

import colorsys

import numpy as np
from jaxtyping import Float

SIDE = 512
Colour = tuple[float, float, float]


def fractal(
    rng: np.random.Generator,
    beta: float = 1.0,
    stretch: tuple[float, float] = (1.0, 1.0),
    side: int = SIDE,
) -> Float[np.ndarray, "t t"]:
    """Noise whose amplitude falls as 1/frequency^beta, with mean 0.5 and standard deviation about 0.2, in [0, 1].

    The spectrum is flat below one cycle per repeat.

    Args:
        rng: random number generator.
        beta: exponent of the amplitude spectrum; about 1 for photos.
        stretch: stretching of the noise along u and v.
        side: side of the texture in texels.
    """
    fv = np.fft.fftfreq(side, 1 / side)[:, None] * stretch[1]
    fu = np.fft.rfftfreq(side, 1 / side)[None] * stretch[0]
    amplitude = (np.maximum(np.hypot(fu, fv), 1.0) ** -beta).astype(np.float32)
    gaussian_noise = rng.standard_normal((side, side // 2 + 1, 2), dtype=np.float32)
    spectrum = (gaussian_noise[..., 0] + 1j * gaussian_noise[..., 1]) * amplitude
    spectrum[0, 0] = 0
    noise = np.fft.irfft2(spectrum, s=(side, side))
    return np.clip(0.5 + 0.2 * noise / noise.std(), 0, 1)


def worley_noise(
    rng: np.random.Generator, grid: int, jitter: float = 0.9
) -> tuple[Float[np.ndarray, "t t"], Float[np.ndarray, "t t"], Float[np.ndarray, "t t"]]:
    """Worley noise of `grid` x `grid` cells: distance to the nearest point, how much farther the second is, cell value.

    Distances are in cells. `jitter` is the side of the square in which each cell's point is drawn, in cells.
    """
    points = (0.5 + jitter * (rng.random((grid, grid, 2)) - 0.5)).astype(np.float32)
    values = rng.random((grid, grid))
    axis = np.arange(SIDE, dtype=np.float32) * grid / SIDE
    v, u = np.meshgrid(axis, axis, indexing="ij")
    cell_v, cell_u = v.astype(int), u.astype(int)
    nearest, second_nearest = np.full((SIDE, SIDE), 9.0, np.float32), np.full((SIDE, SIDE), 9.0, np.float32)
    value = np.zeros((SIDE, SIDE))
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            gv, gu = (cell_v + dv) % grid, (cell_u + du) % grid
            distance = np.hypot(cell_u + du + points[gv, gu, 0] - u, cell_v + dv + points[gv, gu, 1] - v)
            closer = distance < nearest
            second_nearest = np.where(closer, nearest, np.minimum(second_nearest, distance))
            nearest = np.where(closer, distance, nearest)
            value = np.where(closer, values[gv, gu], value)
    return nearest, second_nearest - nearest, value


def wavy(
    rng: np.random.Generator, angle: Float[np.ndarray, " k"], frequencies: tuple[int, ...]
) -> Float[np.ndarray, " k"]:
    """Sum of sine waves round a circle, with random phases and with amplitudes that fall as 1/frequency."""
    result = np.zeros_like(angle)
    for k in frequencies:
        result += rng.normal() / k * np.sin(k * angle + rng.uniform(0, 6.3))
    return result


def step(edge0: float, edge1: float, x: Float[np.ndarray, "*t"]) -> Float[np.ndarray, "*t"]:
    """Smooth step from 0 at `edge0` to 1 at `edge1`."""
    s = np.clip((x - edge0) / (edge1 - edge0), 0, 1)
    return s * s * (3 - 2 * s)


def blend(
    first: Float[np.ndarray, "..."] | Colour, second: Float[np.ndarray, "..."] | Colour, share: Float[np.ndarray, "*t"]
) -> Float[np.ndarray, "t t 3"]:
    """Mix two colours or colour images; `share` is the weight of the second."""
    return np.asarray(first) * (1 - share[..., None]) + np.asarray(second) * share[..., None]


# Hues of man-made objects in photos: mostly from red through wood to beige, some blue, rarely others.
_HUES = ((0.0, 0.05), (0.05, 0.1), (0.07, 0.13), (0.09, 0.15), (0.55, 0.64), (0.22, 0.4), (0.0, 1.0))
_HUE_ODDS = (0.15, 0.25, 0.22, 0.12, 0.14, 0.07, 0.05)


def random_muted_colour(
    rng: np.random.Generator,
    saturation: tuple[float, float] = (0.1, 0.45),
    value: tuple[float, float] = (0.3, 0.75),
    hue: tuple[float, float] | None = None,
) -> Colour:
    """Draw a colour of limited saturation; where no range of hues is given, common hues are more frequent."""
    if hue is None:
        hue = _HUES[int(rng.choice(len(_HUES), p=_HUE_ODDS))]
    return colorsys.hsv_to_rgb(rng.uniform(*hue) % 1.0, rng.uniform(*saturation), rng.uniform(*value))


def random_earth_colour(rng: np.random.Generator, value: tuple[float, float] = (0.25, 0.65)) -> Colour:
    """Draw a colour from brown to grey, as of stone, soil or bark."""
    return random_muted_colour(rng, (0.08, 0.4), value, (0.04, 0.14))


def random_plant_colour(rng: np.random.Generator, value: tuple[float, float] = (0.25, 0.55)) -> Colour:
    """Draw a colour from green to olive, as of plants."""
    return random_muted_colour(rng, (0.3, 0.65), value, (0.17, 0.33))
