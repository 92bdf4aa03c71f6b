"""Scratch memory in which a 16x16 tile is blended, shared by the rasterisers of ellipsoids and of disks.

The memory consists of planes. A plane holds one value for each pixel of the tile, row by row. The first plane is the
transmittance T, which is negative for pixels that have stopped and for pixels outside the image.
"""

import numpy as np

from gaussian_enhancer.compiled import inner
from gaussian_enhancer.splat.thresholds import ALPHA_MAX, ALPHA_MIN, MIN_DEPTH_ALPHA, TILE, TRANSMITTANCE_MIN

PIXELS = TILE * TILE
CHECK_INTERVAL = 8
"""Number of entries of a tile's list between two checks whether all its pixels have stopped."""
PREFETCH_DISTANCE = 8
"""Number of entries by which a Gaussian is prefetched before it is blended."""
ZERO, HALF, ONE, TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
LARGEST_ALPHA = np.float32(ALPHA_MAX)
LOG2_SMALLEST_ALPHA = np.float32(np.log2(ALPHA_MIN))
SMALLEST_T = np.float32(TRANSMITTANCE_MIN)
SMALLEST_OPACITY = np.float32(MIN_DEPTH_ALPHA)
# Unsigned offsets of the planes: with signed ones, Numba's handling of negative indices would hinder vectorisation.
P1, P2, P3, P4 = np.uint64(PIXELS), np.uint64(2 * PIXELS), np.uint64(3 * PIXELS), np.uint64(4 * PIXELS)
P5, P6, P7, P8 = np.uint64(5 * PIXELS), np.uint64(6 * PIXELS), np.uint64(7 * PIXELS), np.uint64(8 * PIXELS)
P9, P10, P11 = np.uint64(9 * PIXELS), np.uint64(10 * PIXELS), np.uint64(11 * PIXELS)


@inner
def scratch(count):  # type: ignore[no-untyped-def]
    """Allocate ``count`` planes that begin on a cache line, as `splat.lanes.load` requires."""
    memory = np.empty(count * PIXELS + 16, np.float32)
    start = (-(memory.ctypes.data // 4)) % 16
    return memory[start : start + count * PIXELS]


@inner
def coordinates(planes, first):  # type: ignore[no-untyped-def]
    """Fill the planes ``first`` and ``first + 1`` with the pixels' column and row within the tile."""
    for p in range(PIXELS):
        planes[first * PIXELS + p] = p % TILE
        planes[(first + 1) * PIXELS + p] = p // TILE


@inner
def reset_tile(planes, count, left, top, width, height):  # type: ignore[no-untyped-def]
    """Set the first ``count`` planes to 0, then T to 1 inside the image and to -1 outside."""
    planes[: count * PIXELS] = ZERO
    for p in range(PIXELS):
        inside = (p % TILE < width - left) & (p // TILE < height - top)
        planes[p] = ONE if inside else -ONE


@inner
def is_opaque(planes):  # type: ignore[no-untyped-def]
    """Whether every pixel of the tile has stopped."""
    remaining = ZERO
    for p in range(PIXELS):
        remaining += max(planes[p], ZERO)
    return remaining == ZERO
