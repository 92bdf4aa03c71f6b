"""Blending of projected Gaussians over 16x16 tiles, front to back, forward and analytic backward, on the CPU.

Axes: n Gaussians, e entries of the tile lists, t tiles, h height, w width.

    alpha_i = min(0.99, 2^(l - u^2 - v^2)),  T_i = prod_{j<i} (1 - alpha_j),
    colour = sum_i T_i alpha_i c_i + T background

The innermost loop runs over a Gaussian's pixel rows of one tile, which lie one after another in a scratch block of
planes; it has no branch, so that 16 pixels share an instruction. The backward goes front to back as well: with v_i the
derivative of the loss by the weight w_i = T_i alpha_i,

    dL/dalpha_i = T_i v_i - (sum_{j>i} w_j v_j + T v_background) / (1 - alpha_i)

where the bracket is the whole pixel's sum, known from the forward's output, less what has been passed already.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32
from numba import get_num_threads, prange

from gaussian_enhancer.splat.compiled import TILE, exp2_nonpositive, inner, kernel, kernel_lock
from gaussian_enhancer.splat.planes import (
    EVERY,
    HALF,
    LARGEST_ALPHA,
    LEAST_OPACITY,
    LOG2_SMALLEST_ALPHA,
    ONE,
    P1,
    P2,
    P3,
    P4,
    P5,
    P6,
    P7,
    P8,
    PIXELS,
    SMALLEST_T,
    ZERO,
    begin,
    coordinates,
    finished,
)
from gaussian_enhancer.splat.tiles import TileLists

GATHERED = 12
"""Columns of `blend_backward`: colour (3), depth, h, h u, h v, h uu, h uv, h vv, |x|, |y|; h = dL/dalpha alpha."""


class Splats(NamedTuple):
    """What is blended: `splat.ewa.Projection`'s footprints, whitening and depths, and colours."""

    footprints: Float64[np.ndarray, "n 6"]
    whitening: Float64[np.ndarray, "n 5"]
    depths: Float32[np.ndarray, " n"]
    colours: Float32[np.ndarray, "n 3"]


class Image(NamedTuple):
    """Blended planes, and how far into its list each tile went before all its pixels had stopped."""

    colour: Float32[np.ndarray, "3 h w"]
    depth: Float32[np.ndarray, "1 h w"]
    alpha: Float32[np.ndarray, "1 h w"]
    median_depth: Float32[np.ndarray, "1 h w"]
    used: Int32[np.ndarray, " t"]


def blend(splats: Splats, lists: TileLists, background: Float32[np.ndarray, " 3"], height: int, width: int) -> Image:
    """Composite the Gaussians of every tile.

    Args:
        splats: projected Gaussians.
        lists: their tiles.
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
) -> Float32[np.ndarray, "e 12"]:
    """Gradients of each entry of the tile lists; to be summed by `splat.tiles.sum_over_tiles`.

    Args:
        splats: as in `blend`.
        lists: as in `blend`.
        image: what `blend` returned.
        colour: gradient of the loss with respect to the colour.
        depth: gradient with respect to the expected depth.
        alpha: gradient with respect to the accumulated alpha.
    """
    with kernel_lock:
        return _blend_backward(splats, lists, image, colour, depth, alpha, get_num_threads())


@inner
def _local(splats, g, left, top):  # type: ignore[no-untyped-def]
    """Whitened coordinates of the tile's first pixel centre; in float64, as the centre may be far away."""
    dx, dy = left + 0.5 - splats.footprints[g, 0], top + 0.5 - splats.footprints[g, 1]
    white = splats.whitening
    a, b, c, d, peak = white[g, 0], white[g, 1], white[g, 2], white[g, 3], white[g, 4]
    u, v = np.float32(a * dx + b * dy), np.float32(c * dx + d * dy)
    return u, v, np.float32(a), np.float32(b), np.float32(c), np.float32(d), np.float32(peak)


@inner
def _blend_rows(planes, first, end, u0, v0, a, b, c, d, peak, red, green, blue, z):  # type: ignore[no-untyped-def]
    """Add one Gaussian to some rows. Planes: T (negative once stopped), r, g, b, sum of depths, median, x, y."""
    for p in range(first, end):
        x, y = planes[p + P6], planes[p + P7]
        u = u0 + a * x + b * y
        v = v0 + c * x + d * y
        t = peak - u * u - v * v
        alpha = min(exp2_nonpositive(t), LARGEST_ALPHA)
        T = planes[p]
        rest = T * (ONE - alpha)
        seen = t >= LOG2_SMALLEST_ALPHA
        adds = seen & (rest >= SMALLEST_T)
        weight = alpha * T if adds else ZERO
        planes[p] = rest if adds else (-abs(T) if seen else T)
        planes[p + P1] += weight * red
        planes[p + P2] += weight * green
        planes[p + P3] += weight * blue
        planes[p + P4] += weight * z
        planes[p + P5] = max(planes[p + P5], z if adds & (T > HALF) else ZERO)  # depths only grow


@inner
def _write(planes, left, top, background, colour, depth, alpha, median):  # type: ignore[no-untyped-def]
    """Normalise a tile's sums and put them into the image."""
    height, width = depth.shape[1], depth.shape[2]
    for j in range(min(TILE, height - top)):
        for i in range(min(TILE, width - left)):
            p = j * TILE + i
            T = abs(planes[p])
            opacity = ONE - T
            for c in range(3):
                colour[c, top + j, left + i] = planes[(c + 1) * PIXELS + p] + T * background[c]
            alpha[0, top + j, left + i] = opacity
            depth[0, top + j, left + i] = planes[4 * PIXELS + p] / opacity if opacity >= LEAST_OPACITY else ZERO
            median[0, top + j, left + i] = planes[5 * PIXELS + p] if T <= HALF else ZERO


@kernel
def _blend(splats, lists, background, height, width, lanes):  # type: ignore[no-untyped-def]
    down, across = -(-height // TILE), -(-width // TILE)
    colour = np.empty((3, height, width), np.float32)
    depth = np.empty((1, height, width), np.float32)
    alpha = np.empty((1, height, width), np.float32)
    median = np.empty((1, height, width), np.float32)
    used = np.zeros(down * across, np.int32)
    for lane in prange(lanes):
        planes = np.empty(8 * PIXELS, np.float32)
        coordinates(planes, 6)
        for tile in range(lane, down * across, lanes):
            left, top = tile % across * TILE, tile // across * TILE
            begin(planes, 6, left, top, width, height)
            count = lists.starts[tile + 1] - lists.starts[tile]
            for k in range(count):
                if k % EVERY == 0 and finished(planes):
                    count = k
                    break
                e = lists.starts[tile] + k
                g = lists.gaussians[e]
                u0, v0, a, b, c, d, peak = _local(splats, g, left, top)
                first, end = np.uint64(TILE * lists.rows[e, 0]), np.uint64(TILE * lists.rows[e, 1])
                red, green, blue = splats.colours[g, 0], splats.colours[g, 1], splats.colours[g, 2]
                _blend_rows(planes, first, end, u0, v0, a, b, c, d, peak, red, green, blue, splats.depths[g])
            used[tile] = count
            _write(planes, left, top, background, colour, depth, alpha, median)
    return colour, depth, alpha, median, used


@inner
def _unblend_rows(planes, first, end, u0, v0, a, b, c, d, peak, red, green, blue, z):  # type: ignore[no-untyped-def]
    """Gradients of one Gaussian. Planes: T, what lies behind, gradients (r, g, b, depth, alpha), x, y."""
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = s8 = s9 = s10 = s11 = ZERO
    for p in range(first, end):
        x, y = planes[p + P7], planes[p + P8]
        u = u0 + a * x + b * y
        v = v0 + c * x + d * y
        t = peak - u * u - v * v
        raw = exp2_nonpositive(t)
        alpha = min(raw, LARGEST_ALPHA)
        T = planes[p]
        rest = T * (ONE - alpha)
        seen = t >= LOG2_SMALLEST_ALPHA
        adds = seen & (rest >= SMALLEST_T)
        weight = alpha * T if adds else ZERO
        planes[p] = rest if adds else (-abs(T) if seen else T)
        by_red, by_green, by_blue = planes[p + P2], planes[p + P3], planes[p + P4]
        by_depth = planes[p + P5]
        value = by_red * red + by_green * green + by_blue * blue + by_depth * z + planes[p + P6]
        behind = planes[p + P1] - weight * value
        planes[p + P1] = behind
        slope = raw * (T * value - behind / (ONE - alpha))
        h = slope if adds & (raw <= LARGEST_ALPHA) else ZERO
        hu, hv = h * u, h * v
        s0 += weight * by_red
        s1 += weight * by_green
        s2 += weight * by_blue
        s3 += weight * by_depth
        s4 += h
        s5 += hu
        s6 += hv
        s7 += hu * u
        s8 += hu * v
        s9 += hv * v
        s10 += abs(a * hu + c * hv)
        s11 += abs(b * hu + d * hv)
    return s0, s1, s2, s3, s4, s5, s6, s7, s8, s9, s10, s11


@inner
def _read(planes, left, top, image, colour, depth, alpha):  # type: ignore[no-untyped-def]
    """Set up a tile for the backward; pixels outside the image have T = 0 and gradients 0."""
    height, width = depth.shape[1], depth.shape[2]
    planes[: 7 * PIXELS] = ZERO
    for j in range(min(TILE, height - top)):
        for i in range(min(TILE, width - left)):
            p, y, x = j * TILE + i, top + j, left + i
            opacity = image.alpha[0, y, x]
            by_alpha, by_sum, total = alpha[0, y, x], ZERO, ZERO
            if opacity >= LEAST_OPACITY:
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
def _blend_backward(splats, lists, image, colour, depth, alpha, lanes):  # type: ignore[no-untyped-def]
    height, width = depth.shape[1], depth.shape[2]
    down, across = -(-height // TILE), -(-width // TILE)
    gathered = np.empty((len(lists.gaussians), GATHERED), np.float32)
    for lane in prange(lanes):
        planes = np.empty(9 * PIXELS, np.float32)
        coordinates(planes, 7)
        for tile in range(lane, down * across, lanes):
            left, top = tile % across * TILE, tile // across * TILE
            _read(planes, left, top, image, colour, depth, alpha)
            start, end = lists.starts[tile], lists.starts[tile + 1]
            gathered[start + image.used[tile] : end] = ZERO
            for e in range(start, start + image.used[tile]):
                g = lists.gaussians[e]
                u0, v0, a, b, c, d, peak = _local(splats, g, left, top)
                first, last = np.uint64(TILE * lists.rows[e, 0]), np.uint64(TILE * lists.rows[e, 1])
                red, green, blue = splats.colours[g, 0], splats.colours[g, 1], splats.colours[g, 2]
                sums = _unblend_rows(planes, first, last, u0, v0, a, b, c, d, peak, red, green, blue, splats.depths[g])
                for k in range(GATHERED):
                    gathered[e, k] = sums[k]
    return gathered
