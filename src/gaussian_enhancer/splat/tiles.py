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
from jaxtyping import Bool, Float, Float32, Int32, Int64, UInt8
from numba import get_num_threads, prange

from gaussian_enhancer.compiled import inner, kernel, kernel_lock
from gaussian_enhancer.splat.thresholds import TILE

_SLACK = 1e-3  # pixels; rounding can only enlarge a footprint, never shrink it
_LARGEST = 1e100  # pixels; a larger footprint counts as not finite


class TileLists(NamedTuple):
    """The entries of all tiles.

    Attributes:
        tile_starts: tile t's entries are ``tile_starts[t]:tile_starts[t + 1]``.
        gaussians: index of each entry's Gaussian; sorted by depth within a tile, ties by index.
        rows: pixel rows [first, end) of the tile, 0..16, that the footprint touches.
        slot_starts: Gaussian g's slots are ``slot_starts[g]:slot_starts[g + 1]``; there are none if it is invisible.
        slots: where the sums of an entry are stored. The slots of a Gaussian are contiguous, so that sums over its
            tiles need no atomic operations.
    """

    tile_starts: Int64[np.ndarray, " t+1"]
    gaussians: Int32[np.ndarray, " e"]
    rows: UInt8[np.ndarray, "e 2"]
    slot_starts: Int64[np.ndarray, " n+1"]
    slots: Int32[np.ndarray, " e"]

    @property
    def visible(self) -> Bool[np.ndarray, " n"]:
        """Mask of the Gaussians that some tile lists."""
        return self.slot_starts[1:] > self.slot_starts[:-1]


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
        slot_starts = _slot_starts(footprints, height, width)
        keys = _depth_keys(slot_starts, depths)
        keys.sort()
        tile_of, rows_of = _list_entries(footprints, slot_starts, height, width)
        tile_count = math.prod(grid(height, width))
        return TileLists(*_sort_entries(slot_starts, keys, tile_of, rows_of, tile_count, get_num_threads()))


def sum_over_tiles(values: Float32[np.ndarray, "e c"], lists: TileLists) -> Float32[np.ndarray, "n c"]:
    """Sum the values of each Gaussian over its tiles, always in the same order."""
    with kernel_lock:
        return _sum_over_tiles(values, lists.slot_starts, get_num_threads())


@inner
def _rows_in_column(footprint, left, height):  # type: ignore[no-untyped-def]
    """First and last image row whose pixel centres lie in the footprint, over one tile column."""
    x, y, half_width, half_height, slope, chord = footprint
    low, high = y - half_height, y + half_height
    if chord >= 0.0:
        a = max(left + 0.5 - x, -half_width)
        b = min(left + (TILE - 0.5) - x, half_width)
        peak = slope * half_width * half_width / max(half_height, 1e-300)
        dx = min(max(peak, a), b)
        high = y + slope * dx + chord * math.sqrt(max(0.0, 1.0 - (dx / half_width) ** 2))
        dx = min(max(-peak, a), b)
        low = y + slope * dx - chord * math.sqrt(max(0.0, 1.0 - (dx / half_width) ** 2))
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
def _slot_starts(footprints, height, width):  # type: ignore[no-untyped-def]
    """Cumulative number of tiles of the Gaussians, from 0."""
    n = len(footprints)
    slot_starts = np.zeros(n + 1, np.int64)
    for g in prange(n):
        footprint = _footprint(footprints, g)
        begin, end = _columns(footprint, width)
        total = 0
        for column in range(begin, end + 1):
            top, bottom = _rows_in_column(footprint, column * TILE, height)
            if bottom >= top:
                total += bottom // TILE - top // TILE + 1
        slot_starts[g + 1] = total
    for g in range(n):
        slot_starts[g + 1] += slot_starts[g]
    return slot_starts


@inner
def _depth_keys(slot_starts, depths):  # type: ignore[no-untyped-def]
    """Visible Gaussians as integers that sort by depth, then by index: positive floats sort like their bits."""
    keys = np.empty(len(depths), np.int64)
    count = 0
    for g in range(len(depths)):
        if slot_starts[g + 1] > slot_starts[g]:
            keys[count] = (np.int64(np.float32(depths[g]).view(np.int32)) << 32) | g
            count += 1
    return keys[:count].copy()


@kernel
def _list_entries(footprints, slot_starts, height, width):  # type: ignore[no-untyped-def]
    """Tile and pixel rows of every entry, in the order of the Gaussians."""
    n, across = len(footprints), -(-width // TILE)
    tile_of = np.empty(slot_starts[n], np.int32)
    rows_of = np.empty((slot_starts[n], 2), np.uint8)
    for g in prange(n):
        if slot_starts[g + 1] > slot_starts[g]:
            footprint = _footprint(footprints, g)
            slot = slot_starts[g]
            begin, end = _columns(footprint, width)
            for column in range(begin, end + 1):
                top, bottom = _rows_in_column(footprint, column * TILE, height)
                for row in range(top // TILE, bottom // TILE + 1 if bottom >= top else 0):
                    tile_of[slot] = row * across + column
                    rows_of[slot, 0] = max(top - row * TILE, 0)
                    rows_of[slot, 1] = min(bottom + 1 - row * TILE, TILE)
                    slot += 1
    return tile_of, rows_of


@kernel
def _sort_entries(slot_starts, keys, tile_of, rows_of, tiles, threads):  # type: ignore[no-untyped-def]
    """Sort entries by tile with a counting sort; each thread takes a contiguous range of keys and keeps their order."""
    total, count = len(tile_of), len(keys)
    cursors = np.zeros((threads, tiles), np.int64)
    for thread in prange(threads):
        for k in range(thread * count // threads, (thread + 1) * count // threads):
            g = keys[k] & 0x7FFFFFFF
            for slot in range(slot_starts[g], slot_starts[g + 1]):
                cursors[thread, tile_of[slot]] += 1
    tile_starts = np.empty(tiles + 1, np.int64)
    entry = 0
    for tile in range(tiles):
        tile_starts[tile] = entry
        for thread in range(threads):
            cursors[thread, tile], entry = entry, entry + cursors[thread, tile]
    tile_starts[tiles] = entry
    gaussians = np.empty(total, np.int32)
    rows = np.empty((total, 2), np.uint8)
    slots = np.empty(total, np.int32)
    for thread in prange(threads):
        for k in range(thread * count // threads, (thread + 1) * count // threads):
            g = keys[k] & 0x7FFFFFFF
            for slot in range(slot_starts[g], slot_starts[g + 1]):
                entry = cursors[thread, tile_of[slot]]
                cursors[thread, tile_of[slot]] = entry + 1
                gaussians[entry] = g
                slots[entry] = slot
                rows[entry, 0], rows[entry, 1] = rows_of[slot, 0], rows_of[slot, 1]
    return tile_starts, gaussians, rows, slot_starts, slots


@kernel
def _sum_over_tiles(values, slot_starts, threads):  # type: ignore[no-untyped-def]
    n, channels = len(slot_starts) - 1, values.shape[1]
    sums = np.empty((n, channels), np.float32)
    for thread in prange(threads):
        for g in range(thread * n // threads, (thread + 1) * n // threads):
            for c in range(channels):
                sums[g, c] = 0.0
            for k in range(slot_starts[g], slot_starts[g + 1]):
                for c in range(channels):
                    sums[g, c] += values[k, c]
    return sums
