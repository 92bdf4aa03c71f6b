"""The block of planes that a 16x16 tile is blended in: what blending of Gaussians and of disks share.

A plane holds one value of each of the tile's pixels, row after row. The first is the transmittance T, which is negative
once a pixel has stopped and outside the image.
"""

import numpy as np

from gaussian_enhancer.splat.compiled import ALPHA_MAX, ALPHA_MIN, COVERED, TILE, TRANSMITTANCE_MIN, inner

PIXELS = TILE * TILE
EVERY = 8
"""Entries of a tile's list between two looks at whether it is finished."""
AHEAD = 8
"""Entries between asking memory for a Gaussian and blending it."""
ZERO, HALF, ONE, TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
LARGEST_ALPHA = np.float32(ALPHA_MAX)
LOG2_SMALLEST_ALPHA = np.float32(np.log2(ALPHA_MIN))
SMALLEST_T = np.float32(TRANSMITTANCE_MIN)
LEAST_OPACITY = np.float32(COVERED)
# Where planes begin, as unsigned offsets: with signed ones Numba's wraparound would hinder vectorisation.
P1, P2, P3, P4 = np.uint64(PIXELS), np.uint64(2 * PIXELS), np.uint64(3 * PIXELS), np.uint64(4 * PIXELS)
P5, P6, P7, P8 = np.uint64(5 * PIXELS), np.uint64(6 * PIXELS), np.uint64(7 * PIXELS), np.uint64(8 * PIXELS)
P9, P10, P11 = np.uint64(9 * PIXELS), np.uint64(10 * PIXELS), np.uint64(11 * PIXELS)


@inner
def scratch(count):  # type: ignore[no-untyped-def]
    """Memory for so many planes that begins on a cache line, as `splat.lanes.load` asks."""
    memory = np.empty(count * PIXELS + 16, np.float32)
    first = (-(memory.ctypes.data // 4)) % 16
    return memory[first : first + count * PIXELS]


@inner
def coordinates(planes, at):  # type: ignore[no-untyped-def]
    """Fill two planes with the pixels' column and row within the tile."""
    for p in range(PIXELS):
        planes[at * PIXELS + p] = p % TILE
        planes[(at + 1) * PIXELS + p] = p // TILE


@inner
def begin(planes, sums, left, top, width, height):  # type: ignore[no-untyped-def]
    """Empty a tile: all sums 0, T = 1 inside the image."""
    planes[: sums * PIXELS] = ZERO
    for p in range(PIXELS):
        inside = (p % TILE < width - left) & (p // TILE < height - top)
        planes[p] = ONE if inside else -ONE


@inner
def is_opaque(planes):  # type: ignore[no-untyped-def]
    """Whether every pixel of the tile has stopped."""
    left = ZERO
    for p in range(PIXELS):
        left += max(planes[p], ZERO)
    return left == ZERO
