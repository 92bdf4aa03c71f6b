"""Lists of the Gaussians that touch each 16x16 tile of the image, front to back.

Axes: n Gaussians, e entries (a Gaussian in a tile), t tiles in row-major order.

Binning does not depend on the rendering method. Its input is each Gaussian's *footprint*, the region outside of which
its alpha is below 1/255. A footprint is a row of six numbers in pixels,

    (x, y, half_width, half_height, slope, chord)

for the ellipse with centre (x, y), bounding box x +- half_width, y +- half_height, and at horizontal offset dx the
vertical range  slope dx +- chord sqrt(1 - (dx / half_width)^2).  For a covariance C and radius r:
half_width = r sqrt(Cxx), half_height = r sqrt(Cyy), slope = Cxy / Cxx, chord = r sqrt(det C / Cxx).

With a negative chord the footprint is the whole bounding box (for footprints that are not ellipses). With a half_width
that is not positive, or with a value that is not finite, it is empty.
A tile, and within it a pixel row, is left out only if none of its pixel centres is inside the footprint.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int32, Int64, UInt8
from numba import get_num_threads, prange

from gaussian_enhancer.splat.compiled import TILE, inner, kernel, kernel_lock

_SLACK = 1e-3  # pixels; rounding can only enlarge a footprint, never shrink it
_LARGEST = 1e100  # pixels; a larger footprint counts as not finite


class TileLists(NamedTuple):
    """The entries of all tiles.

    Attributes:
        starts: tile t's entries are ``starts[t]:starts[t + 1]``.
        gaussians: index of each entry's Gaussian; sorted by depth within a tile, ties by index.
        rows: pixel rows [first, end) of the tile, 0..16, that the footprint touches.
        first: Gaussian g's slots are ``first[g]:first[g + 1]``; there are none if it is invisible.
        slots: where the sums of an entry are stored. The slots of a Gaussian are contiguous, so that sums over its
            tiles need no atomic operations.
    """

    starts: Int64[np.ndarray, " t+1"]
    gaussians: Int32[np.ndarray, " e"]
    rows: UInt8[np.ndarray, "e 2"]
    first: Int64[np.ndarray, " n+1"]
    slots: Int32[np.ndarray, " e"]


def grid(height: int, width: int) -> tuple[int, int]:
    """Tile rows and tile columns of an image; tile t covers row ``t // columns`` and column ``t % columns``."""
    return -(-height // TILE), -(-width // TILE)


def bin_tiles(
    footprints: Float[np.ndarray, "n 6"], depths: Float32[np.ndarray, " n"], height: int, width: int
) -> TileLists:
    """List the Gaussians of every tile by increasing depth.

    Args:
        footprints: in float64, as defined in the module's docstring.
        depths: z of the centres, positive; read only where the footprint is not empty.
        height: image height in pixels.
        width: image width in pixels.
    """
    with kernel_lock:
        first = _count(footprints, height, width)
        keys = _depth_keys(first, depths)
        keys.sort()
        tile_of, rows_of = _list_entries(footprints, first, height, width)
        down, across = grid(height, width)
        return TileLists(*_sort_entries(first, keys, tile_of, rows_of, down * across, get_num_threads()))


def sum_over_tiles(values: Float32[np.ndarray, "e c"], lists: TileLists) -> Float32[np.ndarray, "n c"]:
    """Sum the values of each Gaussian over its tiles, always in the same order."""
    with kernel_lock:
        return _sum_over_tiles(values, lists.first, get_num_threads())


@inner
def _rows_in_column(footprint, left, height):  # type: ignore[no-untyped-def]
    """First and last image row whose pixel centres lie in the footprint, over one tile column."""
    x, y, half_width, half_height, slope, chord = footprint
    low, high = y - half_height, y + half_height
    if chord >= 0.0:
        a = max(left + 0.5 - x, -half_width)
        b = min(left + (TILE - 0.5) - x, half_width)
        peak = slope * half_width * half_width / max(half_height, 1e-300)
        at = min(max(peak, a), b)
        high = y + slope * at + chord * math.sqrt(max(0.0, 1.0 - (at / half_width) ** 2))
        at = min(max(-peak, a), b)
        low = y + slope * at - chord * math.sqrt(max(0.0, 1.0 - (at / half_width) ** 2))
    slack = _SLACK + 1e-9 * (abs(x) + abs(y) + half_width + half_height)
    top = math.ceil(max(low - slack - 0.5, 0.0))
    bottom = math.floor(min(high + slack - 0.5, height - 1.0))
    return int(top), int(bottom)


@inner
def _columns(footprint, width):  # type: ignore[no-untyped-def]
    """First and last tile column of a footprint; last < first if there is none."""
    x, y, half_width, half_height, slope, chord = footprint
    # Not math.isfinite: it subtracts, and reassociated terms cancel.
    size = abs(x) + abs(y) + half_width + abs(half_height) + abs(slope) + abs(chord)
    if not (half_width > 0.0 and size <= _LARGEST):
        return 0, -1
    slack = _SLACK + 1e-9 * (abs(x) + half_width)
    left = math.ceil(max(x - half_width - slack - 0.5, 0.0))
    right = math.floor(min(x + half_width + slack - 0.5, width - 1.0))
    if right < left:
        return 0, -1
    return int(left) // TILE, int(right) // TILE


@inner
def _footprint(footprints, g):  # type: ignore[no-untyped-def]
    return (
        footprints[g, 0], footprints[g, 1], footprints[g, 2], footprints[g, 3], footprints[g, 4], footprints[g, 5],
    )  # fmt: skip


@kernel
def _count(footprints, height, width):  # type: ignore[no-untyped-def]
    n = len(footprints)
    first = np.zeros(n + 1, np.int64)
    for g in prange(n):
        footprint = _footprint(footprints, g)
        begin, end = _columns(footprint, width)
        total = 0
        for column in range(begin, end + 1):
            top, bottom = _rows_in_column(footprint, column * TILE, height)
            if bottom >= top:
                total += bottom // TILE - top // TILE + 1
        first[g + 1] = total
    for g in range(n):
        first[g + 1] += first[g]
    return first


@inner
def _depth_keys(first, depths):  # type: ignore[no-untyped-def]
    """Visible Gaussians as integers that sort by depth, then by index: positive floats sort like their bits."""
    keys = np.empty(len(depths), np.int64)
    count = 0
    for g in range(len(depths)):
        if first[g + 1] > first[g]:
            keys[count] = (np.int64(np.float32(depths[g]).view(np.int32)) << 32) | g
            count += 1
    return keys[:count].copy()


@kernel
def _list_entries(footprints, first, height, width):  # type: ignore[no-untyped-def]
    """Tile and pixel rows of every entry, in the order of the Gaussians."""
    n, across = len(footprints), -(-width // TILE)
    tile_of = np.empty(first[n], np.int32)
    rows_of = np.empty((first[n], 2), np.uint8)
    for g in prange(n):
        if first[g + 1] > first[g]:
            footprint = _footprint(footprints, g)
            at = first[g]
            begin, end = _columns(footprint, width)
            for column in range(begin, end + 1):
                top, bottom = _rows_in_column(footprint, column * TILE, height)
                for row in range(top // TILE, bottom // TILE + 1 if bottom >= top else 0):
                    tile_of[at] = row * across + column
                    rows_of[at, 0] = max(top - row * TILE, 0)
                    rows_of[at, 1] = min(bottom + 1 - row * TILE, TILE)
                    at += 1
    return tile_of, rows_of


@kernel
def _sort_entries(first, keys, tile_of, rows_of, tiles, lanes):  # type: ignore[no-untyped-def]
    """Sort entries by tile with a counting sort; each lane takes a contiguous range of keys and keeps their order."""
    total, count = len(tile_of), len(keys)
    cursors = np.zeros((lanes, tiles), np.int64)
    for lane in prange(lanes):
        for k in range(lane * count // lanes, (lane + 1) * count // lanes):
            g = keys[k] & 0x7FFFFFFF
            for pair in range(first[g], first[g + 1]):
                cursors[lane, tile_of[pair]] += 1
    starts = np.empty(tiles + 1, np.int64)
    at = 0
    for tile in range(tiles):
        starts[tile] = at
        for lane in range(lanes):
            cursors[lane, tile], at = at, at + cursors[lane, tile]
    starts[tiles] = at
    gaussians = np.empty(total, np.int32)
    rows = np.empty((total, 2), np.uint8)
    slots = np.empty(total, np.int32)
    for lane in prange(lanes):
        for k in range(lane * count // lanes, (lane + 1) * count // lanes):
            g = keys[k] & 0x7FFFFFFF
            for pair in range(first[g], first[g + 1]):
                at = cursors[lane, tile_of[pair]]
                cursors[lane, tile_of[pair]] = at + 1
                gaussians[at] = g
                slots[at] = pair
                rows[at, 0], rows[at, 1] = rows_of[pair, 0], rows_of[pair, 1]
    return starts, gaussians, rows, first, slots


@kernel
def _sum_over_tiles(values, first, lanes):  # type: ignore[no-untyped-def]
    n, channels = len(first) - 1, values.shape[1]
    sums = np.empty((n, channels), np.float32)
    for lane in prange(lanes):
        for g in range(lane * n // lanes, (lane + 1) * n // lanes):
            for c in range(channels):
                sums[g, c] = 0.0
            for k in range(first[g], first[g + 1]):
                for c in range(channels):
                    sums[g, c] += values[k, c]
    return sums
