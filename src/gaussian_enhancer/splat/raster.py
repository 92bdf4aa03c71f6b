"""Blending of projected Gaussians over 16x16 tiles, front to back, forward and analytic backward, on the CPU.

Axes: n Gaussians, e entries of the tile lists, t tiles, h height, w width.

    alpha_i = min(0.99, 2^(l - u^2 - v^2)),  T_i = prod_{j<i} (1 - alpha_j),
    colour = sum_i T_i alpha_i c_i + T background

The innermost loop runs over the pixel rows of one tile that a Gaussian touches. One instruction processes the 16 pixels
of a row (`splat.lanes`), and the sums of the backward stay in registers. The data of the next Gaussians is prefetched.
The backward also goes front to back. With v_i the derivative of the loss with respect to the weight w_i = T_i alpha_i,

    dL/dalpha_i = T_i v_i - (sum_{j>i} w_j v_j + T v_background) / (1 - alpha_i)

where the bracket is the sum over the whole pixel, known from the output of the forward, minus the terms of Gaussians up
to i.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32
from numba import get_num_threads, prange

from gaussian_enhancer.compiled import inner, kernel, kernel_lock
from gaussian_enhancer.splat.lanes import (
    broadcast,
    exp2_of,
    lane_indices,
    load,
    magnitude,
    minimum,
    prefetch,
    select_less,
    store,
    store_sums,
)
from gaussian_enhancer.splat.planes import (
    CHECK_INTERVAL,
    HALF,
    LARGEST_ALPHA,
    LOG2_SMALLEST_ALPHA,
    ONE,
    PIXELS,
    PREFETCH_DISTANCE,
    SMALLEST_OPACITY,
    SMALLEST_T,
    ZERO,
    is_opaque,
    reset_tile,
    scratch,
)
from gaussian_enhancer.splat.thresholds import TILE
from gaussian_enhancer.splat.tiles import TileLists

GRADIENT_COLUMNS = 16
"""Columns of `blend_backward`: colour (3), depth, h, h u, h v, h uu, h uv, h vv, six unused;
h = dL/dalpha alpha."""


class Splats(NamedTuple):
    """Inputs of the blending: footprints, whitening and depths of `splat.ewa.Projection`, and colours."""

    footprints: Float64[np.ndarray, "n 6"]
    whitening: Float64[np.ndarray, "n 5"]
    depths: Float32[np.ndarray, " n"]
    colours: Float32[np.ndarray, "n 3"]


class Image(NamedTuple):
    """Blended planes, and how many entries of its list each tile blended before all its pixels had stopped."""

    colour: Float32[np.ndarray, "3 h w"]
    depth: Float32[np.ndarray, "1 h w"]
    alpha: Float32[np.ndarray, "1 h w"]
    median_depth: Float32[np.ndarray, "1 h w"]
    blended_counts: Int32[np.ndarray, " t"]


def blend(splats: Splats, lists: TileLists, background: Float32[np.ndarray, " 3"], height: int, width: int) -> Image:
    """Composite the Gaussians of every tile.

    Args:
        splats: projected Gaussians.
        lists: the Gaussians of each tile.
        background: colour behind everything.
        height: image height in pixels.
        width: image width in pixels.
    """
    with kernel_lock:
        return Image(*_blend(splats, lists, background, height, width, get_num_threads()))


def blend_backward(
    splats: Splats,
    lists: TileLists,
    image: Image,
    colour: Float32[np.ndarray, "3 h w"],
    depth: Float32[np.ndarray, "1 h w"],
    alpha: Float32[np.ndarray, "1 h w"],
) -> Float32[np.ndarray, "e 16"]:
    """Gradients of each entry of the tile lists; to be summed by `splat.tiles.sum_over_tiles`.

    Args:
        splats: as in `blend`.
        lists: as in `blend`.
        image: result of `blend`.
        colour: gradient of the loss with respect to the colour.
        depth: gradient with respect to the expected depth.
        alpha: gradient with respect to the accumulated alpha.
    """
    with kernel_lock:
        return _blend_backward(splats, lists, image, colour, depth, alpha, get_num_threads())


@kernel
def _pack_splats(splats, slot_starts):  # type: ignore[no-untyped-def]
    """Pack each visible Gaussian into one cache line: centre and whitening in float64, peak and colour in float32."""
    n = len(slot_starts) - 1
    memory = np.empty(8 * n + 8, np.float64)
    start = (-(memory.ctypes.data // 8)) % 8
    records = memory[start : start + 8 * n].reshape(n, 8)
    singles = records.view(np.float32)
    for g in prange(n):
        if slot_starts[g + 1] > slot_starts[g]:
            records[g, 0], records[g, 1] = splats.footprints[g, 0], splats.footprints[g, 1]
            for k in range(4):
                records[g, 2 + k] = splats.whitening[g, k]
            singles[g, 12] = splats.whitening[g, 4]
            for c in range(3):
                singles[g, 13 + c] = splats.colours[g, c]
    return records, singles


@inner
def _whitened_coordinates(record, left, top, columns):  # type: ignore[no-untyped-def]
    """Whitened coordinates of the tile's first row of pixel centres, and the slopes a, b, c, d.

    Those of the first pixel are computed in float64, since the centre may be far away.
    """
    dx, dy = left + 0.5 - record[0], top + 0.5 - record[1]
    a, b, c, d = record[2], record[3], record[4], record[5]
    u, v = np.float32(a * dx + b * dy), np.float32(c * dx + d * dy)
    a, b, c, d = np.float32(a), np.float32(b), np.float32(c), np.float32(d)
    return u + columns * a, v + columns * c, (a, b, c, d)


@inner
def _blend_entry(planes, rows, u, v, slopes, single, z):  # type: ignore[no-untyped-def]
    """Blend one Gaussian into the rows that it touches.

    Planes: T (negative once stopped), r, g, b, sum of depths, median depth.
    """
    _, b, _, d = slopes
    peak, red, green, blue = single[12], single[13], single[14], single[15]
    u, v = u + b * np.float32(rows[0]), v + d * np.float32(rows[0])
    for row in range(rows[0], rows[1]):
        p = row * TILE
        t = peak - u * u - v * v
        alpha = select_less(t, LOG2_SMALLEST_ALPHA, ZERO, minimum(exp2_of(t), LARGEST_ALPHA))
        T = load(planes, p)
        weight = alpha * T
        T_after = T - weight
        weight = select_less(T_after, SMALLEST_T, ZERO, weight)
        store(planes, p, select_less(T_after, SMALLEST_T, ZERO - magnitude(T), T_after))
        store(planes, p + 1 * PIXELS, load(planes, p + 1 * PIXELS) + weight * red)
        store(planes, p + 2 * PIXELS, load(planes, p + 2 * PIXELS) + weight * green)
        store(planes, p + 3 * PIXELS, load(planes, p + 3 * PIXELS) + weight * blue)
        store(planes, p + 4 * PIXELS, load(planes, p + 4 * PIXELS) + weight * z)
        median = load(planes, p + 5 * PIXELS)
        median = select_less(HALF, T, select_less(ZERO, weight, broadcast(z), median), median)
        store(planes, p + 5 * PIXELS, median)  # depths only grow: the last Gaussian that meets T > 1/2 remains
        u, v = u + b, v + d


@inner
def _write_tile(planes, left, top, background, colour, depth, alpha, median):  # type: ignore[no-untyped-def]
    """Normalise a tile's sums and write them to the image."""
    height, width = depth.shape[1], depth.shape[2]
    for j in range(min(TILE, height - top)):
        for i in range(min(TILE, width - left)):
            p = j * TILE + i
            T = abs(planes[p])
            opacity = ONE - T
            for c in range(3):
                colour[c, top + j, left + i] = planes[(c + 1) * PIXELS + p] + T * background[c]
            alpha[0, top + j, left + i] = opacity
            depth[0, top + j, left + i] = planes[4 * PIXELS + p] / opacity if opacity >= SMALLEST_OPACITY else ZERO
            median[0, top + j, left + i] = planes[5 * PIXELS + p] if T <= HALF else ZERO


@kernel
def _blend(splats, lists, background, height, width, threads):  # type: ignore[no-untyped-def]
    down, across = -(-height // TILE), -(-width // TILE)
    colour = np.empty((3, height, width), np.float32)
    depth = np.empty((1, height, width), np.float32)
    alpha = np.empty((1, height, width), np.float32)
    median = np.empty((1, height, width), np.float32)
    blended_counts = np.zeros(down * across, np.int32)
    records, singles = _pack_splats(splats, lists.slot_starts)
    last = len(lists.gaussians) - 1
    for thread in prange(threads):
        planes, columns = scratch(6), lane_indices()
        for tile in range(thread, down * across, threads):
            left, top = tile % across * TILE, tile // across * TILE
            reset_tile(planes, 6, left, top, width, height)
            count = lists.tile_starts[tile + 1] - lists.tile_starts[tile]
            for k in range(count):
                if k % CHECK_INTERVAL == 0 and is_opaque(planes):
                    count = k
                    break
                e = lists.tile_starts[tile] + k
                prefetch(records, lists.gaussians[min(e + PREFETCH_DISTANCE, last)])
                g = lists.gaussians[e]
                u, v, slopes = _whitened_coordinates(records[g], left, top, columns)
                _blend_entry(planes, lists.rows[e], u, v, slopes, singles[g], splats.depths[g])
            blended_counts[tile] = count
            _write_tile(planes, left, top, background, colour, depth, alpha, median)
    return colour, depth, alpha, median, blended_counts


@inner
def _entry_gradients(planes, rows, u, v, slopes, single, z, gradients, slot):  # type: ignore[no-untyped-def]
    """Gradients of one Gaussian, summed over the rows that it touches.

    Planes: T, the sum over what lies behind (the bracket above), gradients (r, g, b, depth, alpha).
    """
    _, b, _, d = slopes
    peak, red, green, blue = single[12], single[13], single[14], single[15]
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = s8 = s9 = broadcast(ZERO)
    u, v = u + b * np.float32(rows[0]), v + d * np.float32(rows[0])
    for row in range(rows[0], rows[1]):
        p = row * TILE
        t = peak - u * u - v * v
        raw = select_less(t, LOG2_SMALLEST_ALPHA, ZERO, exp2_of(t))
        alpha = minimum(raw, LARGEST_ALPHA)
        T = load(planes, p)
        weight = alpha * T
        T_after = T - weight
        weight = select_less(T_after, SMALLEST_T, ZERO, weight)
        store(planes, p, select_less(T_after, SMALLEST_T, ZERO - magnitude(T), T_after))
        by_red, by_green = load(planes, p + 2 * PIXELS), load(planes, p + 3 * PIXELS)
        by_blue, by_depth = load(planes, p + 4 * PIXELS), load(planes, p + 5 * PIXELS)
        value = by_red * red + by_green * green + by_blue * blue + by_depth * z + load(planes, p + 6 * PIXELS)
        behind = load(planes, p + PIXELS) - weight * value
        store(planes, p + PIXELS, behind)
        slope = raw * (T * value - behind / (ONE - alpha))
        h = select_less(T_after, SMALLEST_T, ZERO, select_less(LARGEST_ALPHA, raw, ZERO, slope))
        hu, hv = h * u, h * v
        s0, s1, s2 = s0 + weight * by_red, s1 + weight * by_green, s2 + weight * by_blue
        s3, s4, s5, s6 = s3 + weight * by_depth, s4 + h, s5 + hu, s6 + hv
        s7, s8, s9 = s7 + hu * u, s8 + hu * v, s9 + hv * v
        u, v = u + b, v + d
    store_sums(gradients, slot, (s0, s1, s2, s3, s4, s5, s6, s7, s8, s9))


@inner
def _read_tile(planes, left, top, image, colour, depth, alpha):  # type: ignore[no-untyped-def]
    """Initialise a tile for the backward; pixels outside the image have T = 0 and gradients 0."""
    height, width = depth.shape[1], depth.shape[2]
    planes[: 7 * PIXELS] = ZERO
    for j in range(min(TILE, height - top)):
        for i in range(min(TILE, width - left)):
            p, y, x = j * TILE + i, top + j, left + i
            opacity = image.alpha[0, y, x]
            by_alpha, by_sum, total = alpha[0, y, x], ZERO, ZERO
            if opacity >= SMALLEST_OPACITY:
                by_sum = depth[0, y, x] / opacity
                by_alpha -= by_sum * image.depth[0, y, x]
            for c in range(3):
                planes[(2 + c) * PIXELS + p] = colour[c, y, x]
                total += colour[c, y, x] * image.colour[c, y, x]
            planes[p] = ONE
            planes[PIXELS + p] = total + opacity * (by_sum * image.depth[0, y, x] + by_alpha)
            planes[5 * PIXELS + p] = by_sum
            planes[6 * PIXELS + p] = by_alpha


@kernel
def _blend_backward(splats, lists, image, colour, depth, alpha, threads):  # type: ignore[no-untyped-def]
    height, width = depth.shape[1], depth.shape[2]
    down, across = -(-height // TILE), -(-width // TILE)
    gradients = np.empty((len(lists.gaussians), GRADIENT_COLUMNS), np.float32)
    records, singles = _pack_splats(splats, lists.slot_starts)
    last = len(lists.gaussians) - 1
    for thread in prange(threads):
        planes, columns = scratch(7), lane_indices()
        for tile in range(thread, down * across, threads):
            left, top = tile % across * TILE, tile // across * TILE
            _read_tile(planes, left, top, image, colour, depth, alpha)
            start, end = lists.tile_starts[tile], lists.tile_starts[tile + 1]
            for e in range(start, start + image.blended_counts[tile]):
                prefetch(records, lists.gaussians[min(e + PREFETCH_DISTANCE, last)])
                prefetch(gradients, lists.slots[min(e + PREFETCH_DISTANCE, last)])
                g = lists.gaussians[e]
                u, v, slopes = _whitened_coordinates(records[g], left, top, columns)
                z = splats.depths[g]
                _entry_gradients(planes, lists.rows[e], u, v, slopes, singles[g], z, gradients, lists.slots[e])
            for e in range(start + image.blended_counts[tile], end):
                gradients[lists.slots[e]] = ZERO
    return gradients
