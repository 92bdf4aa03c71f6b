"""Blending of disks over 16x16 tiles (2DGS), front to back, forward and analytic backward, on the CPU.

Axes: n Gaussians, e entries of the tile lists, t tiles, h height, w width.

The counterpart of `splat.raster` for disks: the same scratch planes, a branch-free loop over a disk's pixel rows and
the same front-to-back backward. The formulas of alpha and depth differ (Huang et al. 2024, equation 11). U, V and D of
`splat.disks` are linear in the pixel's position. With d the pixel's offset from the projected centre and l the log2 of
the opacity,

    (u, v) = (U, V) / D,   alpha = min(0.99, 2^(l - log2(e)/2 min(u^2 + v^2, 2 |d|^2))),   z = z_0 D_0 / D,

where the ray's intersection with the disk counts if it lies beyond the near plane and u^2 + v^2 is less than the
low-pass 2 |d|^2. Otherwise the low-pass replaces it, and the depth is the centre's z_0. The test contains no division,
so that disks seen edge-on need no special case.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32
from numba import get_num_threads, prange

from gaussian_enhancer.compiled import exp2_nonpositive, inner, kernel, kernel_lock
from gaussian_enhancer.splat.planes import (
    CHECK_INTERVAL,
    HALF,
    LARGEST_ALPHA,
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
    P9,
    P10,
    P11,
    PIXELS,
    SMALLEST_OPACITY,
    SMALLEST_T,
    TWO,
    ZERO,
    coordinates,
    is_opaque,
    reset_tile,
)
from gaussian_enhancer.splat.thresholds import TILE
from gaussian_enhancer.splat.tiles import TileLists

GRADIENT_COLUMNS = 20
"""Columns of `blend_disks_backward`: colour (3), centre x and y, C (4), D_0, D_x, D_y, z_0 D_0 (hits), z_0 (low-pass),
log opacity, normal (3), and the sums of the absolute values of the pixels' terms of the centre's x and y. The last two
are not read. Without them the compiler sums the centre's x and y in another order, and gradients differ in the last
bit."""

_HALF_LOG2_E = np.float32(0.5 * np.log2(np.e))
_FAINT = np.float32(1e-12)  # a shorter sum of normals has no direction, as in torch.nn.functional.normalize


class DiskSplats(NamedTuple):
    """Inputs of the blending: members of `splat.disks.Disks`, colours, and the near plane."""

    geometry: Float64[np.ndarray, "n 9"]
    peaks: Float32[np.ndarray, " n"]
    depths: Float32[np.ndarray, " n"]
    normals: Float32[np.ndarray, "n 3"]
    colours: Float32[np.ndarray, "n 3"]
    near: float


class DiskImage(NamedTuple):
    """Blended planes, the summed normals before normalisation, and how many entries of its list each tile blended."""

    colour: Float32[np.ndarray, "3 h w"]
    depth: Float32[np.ndarray, "1 h w"]
    alpha: Float32[np.ndarray, "1 h w"]
    median_depth: Float32[np.ndarray, "1 h w"]
    normals: Float32[np.ndarray, "3 h w"]
    summed: Float32[np.ndarray, "3 h w"]
    blended_counts: Int32[np.ndarray, " t"]


def blend_disks(
    splats: DiskSplats, lists: TileLists, background: Float32[np.ndarray, " 3"], height: int, width: int
) -> DiskImage:
    """Composite the disks of every tile.

    Args:
        splats: projected disks.
        lists: the disks of each tile.
        background: colour behind everything.
        height: image height in pixels.
        width: image width in pixels.
    """
    with kernel_lock:
        return DiskImage(*_blend(splats, lists, background, height, width, get_num_threads()))


def blend_disks_backward(
    splats: DiskSplats,
    lists: TileLists,
    image: DiskImage,
    colour: Float32[np.ndarray, "3 h w"],
    depth: Float32[np.ndarray, "1 h w"],
    alpha: Float32[np.ndarray, "1 h w"],
    normals: Float32[np.ndarray, "3 h w"],
) -> Float32[np.ndarray, "e 20"]:
    """Gradients of each entry of the tile lists; to be summed by `splat.tiles.sum_over_tiles`.

    Args:
        splats: as in `blend_disks`.
        lists: as in `blend_disks`.
        image: result of `blend_disks`.
        colour: gradient of the loss with respect to the colour.
        depth: gradient with respect to the expected depth.
        alpha: gradient with respect to the accumulated alpha.
        normals: gradient with respect to the unit normals.
    """
    with kernel_lock:
        return _blend_backward(splats, lists, image, colour, depth, alpha, normals, get_num_threads())


@inner
def _linear_forms(splats, g, left, top):  # type: ignore[no-untyped-def]
    """U, V and D as (constant, slope in x, slope in y) about the tile's first pixel centre, its offset, and z_0 D_0.

    The offset is from the projected centre of the disk to that pixel centre.
    """
    geometry = splats.geometry
    dx, dy = left + 0.5 - geometry[g, 0], top + 0.5 - geometry[g, 1]
    c00, c01, c10, c11 = geometry[g, 2], geometry[g, 3], geometry[g, 4], geometry[g, 5]
    d0, d1, d2 = geometry[g, 6], geometry[g, 7], geometry[g, 8]
    u = np.float32(c00 * dx + c01 * dy), np.float32(c00), np.float32(c01)
    v = np.float32(c10 * dx + c11 * dy), np.float32(c10), np.float32(c11)
    d = np.float32(d0 + d1 * dx + d2 * dy), np.float32(d1), np.float32(d2)
    return u, v, d, (np.float32(dx), np.float32(dy)), np.float32(d0 * splats.depths[g])


@inner
def _blend_rows(planes, first, end, u, v, d, offset, hit_z, z0, near, peak, colour, normal):  # type: ignore[no-untyped-def]
    """Blend one disk into the pixels ``first`` to ``end`` of a tile.

    Planes: T (negative once stopped), r, g, b, sum of depths, median depth, three of normals, x, y.
    """
    for p in range(first, end):
        x, y = planes[p + P9], planes[p + P10]
        U = u[0] + u[1] * x + u[2] * y
        V = v[0] + v[1] * x + v[2] * y
        D = d[0] + d[1] * x + d[2] * y
        dx, dy = offset[0] + x, offset[1] + y
        square, low_pass = U * U + V * V, TWO * (dx * dx + dy * dy)
        hit = (square < low_pass * D * D) & (D > ZERO) & (hit_z > near * D)
        inverse = ONE / (D if hit else ONE)
        t = peak - _HALF_LOG2_E * (square * inverse * inverse if hit else low_pass)
        z = hit_z * inverse if hit else z0
        alpha = min(exp2_nonpositive(t), LARGEST_ALPHA)
        T = planes[p]
        T_after = T * (ONE - alpha)
        contributes = t >= LOG2_SMALLEST_ALPHA
        blends = contributes & (T_after >= SMALLEST_T)
        weight = alpha * T if blends else ZERO
        planes[p] = T_after if blends else (-abs(T) if contributes else T)
        planes[p + P1] += weight * colour[0]
        planes[p + P2] += weight * colour[1]
        planes[p + P3] += weight * colour[2]
        planes[p + P4] += weight * z
        planes[p + P5] += z if blends & (T > HALF) & (T_after <= HALF) else ZERO  # true for one disk a pixel at most
        planes[p + P6] += weight * normal[0]
        planes[p + P7] += weight * normal[1]
        planes[p + P8] += weight * normal[2]


@inner
def _write_tile(planes, left, top, background, image):  # type: ignore[no-untyped-def]
    """Normalise a tile's sums and write them to the image."""
    colour, depth, alpha, median, normals, summed = image
    height, width = depth.shape[1], depth.shape[2]
    for j in range(min(TILE, height - top)):
        for i in range(min(TILE, width - left)):
            p, y, x = j * TILE + i, top + j, left + i
            T = abs(planes[p])
            opacity = ONE - T
            covered = opacity >= SMALLEST_OPACITY
            for c in range(3):
                colour[c, y, x] = planes[(c + 1) * PIXELS + p] + T * background[c]
                summed[c, y, x] = planes[(c + 6) * PIXELS + p]
            length = np.sqrt(summed[0, y, x] ** 2 + summed[1, y, x] ** 2 + summed[2, y, x] ** 2)
            for c in range(3):
                normals[c, y, x] = summed[c, y, x] / max(length, _FAINT) if covered else ZERO
            alpha[0, y, x] = opacity
            depth[0, y, x] = planes[4 * PIXELS + p] / opacity if covered else ZERO
            median[0, y, x] = planes[5 * PIXELS + p] if T <= HALF else ZERO


@kernel
def _blend(splats, lists, background, height, width, threads):  # type: ignore[no-untyped-def]
    down, across = -(-height // TILE), -(-width // TILE)
    colour, normals = np.empty((3, height, width), np.float32), np.empty((3, height, width), np.float32)
    summed, depth = np.empty((3, height, width), np.float32), np.empty((1, height, width), np.float32)
    alpha, median = np.empty((1, height, width), np.float32), np.empty((1, height, width), np.float32)
    blended_counts = np.zeros(down * across, np.int32)
    near = np.float32(splats.near)
    for thread in prange(threads):
        planes = np.empty(11 * PIXELS, np.float32)
        coordinates(planes, 9)
        for tile in range(thread, down * across, threads):
            left, top = tile % across * TILE, tile // across * TILE
            reset_tile(planes, 9, left, top, width, height)
            count = lists.tile_starts[tile + 1] - lists.tile_starts[tile]
            for k in range(count):
                if k % CHECK_INTERVAL == 0 and is_opaque(planes):
                    count = k
                    break
                e = lists.tile_starts[tile] + k
                g = lists.gaussians[e]
                u, v, d, offset, hit_z = _linear_forms(splats, g, left, top)
                first_pixel, end_pixel = np.uint64(TILE * lists.rows[e, 0]), np.uint64(TILE * lists.rows[e, 1])
                tint = splats.colours[g, 0], splats.colours[g, 1], splats.colours[g, 2]
                normal = splats.normals[g, 0], splats.normals[g, 1], splats.normals[g, 2]
                z0, peak = splats.depths[g], splats.peaks[g]
                _blend_rows(planes, first_pixel, end_pixel, u, v, d, offset, hit_z, z0, near, peak, tint, normal)
            blended_counts[tile] = count
            _write_tile(planes, left, top, background, (colour, depth, alpha, median, normals, summed))
    return colour, depth, alpha, median, normals, summed, blended_counts


@inner
def _row_gradients(planes, first, end, u, v, d, offset, hit_z, z0, near, peak, colour, normal):  # type: ignore[no-untyped-def]
    """Gradients of one disk, summed over the pixels ``first`` to ``end`` of a tile.

    Planes: T, the sum over what lies behind (the bracket in `splat.raster`), eight gradients (r, g, b, depth, alpha,
    three of normals), x, y.
    """
    red = green = blue = sx = sy = su = sux = suy = sv = svx = svy = ZERO
    sd = sdx = sdy = sz = sz0 = so = snx = sny = snz = ax = ay = ZERO
    for p in range(first, end):
        x, y = planes[p + P10], planes[p + P11]
        U = u[0] + u[1] * x + u[2] * y
        V = v[0] + v[1] * x + v[2] * y
        D = d[0] + d[1] * x + d[2] * y
        dx, dy = offset[0] + x, offset[1] + y
        square, low_pass = U * U + V * V, TWO * (dx * dx + dy * dy)
        hit = (square < low_pass * D * D) & (D > ZERO) & (hit_z > near * D)
        inverse = ONE / (D if hit else ONE)
        t = peak - _HALF_LOG2_E * (square * inverse * inverse if hit else low_pass)
        z = hit_z * inverse if hit else z0
        raw = exp2_nonpositive(t)
        alpha = min(raw, LARGEST_ALPHA)
        T = planes[p]
        T_after = T * (ONE - alpha)
        contributes = t >= LOG2_SMALLEST_ALPHA
        blends = contributes & (T_after >= SMALLEST_T)
        weight = alpha * T if blends else ZERO
        planes[p] = T_after if blends else (-abs(T) if contributes else T)
        by_red, by_green, by_blue, by_depth = planes[p + P2], planes[p + P3], planes[p + P4], planes[p + P5]
        by_x, by_y, by_z = planes[p + P7], planes[p + P8], planes[p + P9]
        value = by_red * colour[0] + by_green * colour[1] + by_blue * colour[2] + by_depth * z + planes[p + P6]
        value += by_x * normal[0] + by_y * normal[1] + by_z * normal[2]
        behind = planes[p + P1] - weight * value
        planes[p + P1] = behind
        slope = raw * (T * value - behind / (ONE - alpha))
        h = slope if blends & (raw <= LARGEST_ALPHA) else ZERO
        by_hit = h * inverse if hit else ZERO
        by_miss = ZERO if hit else TWO * h
        depth = weight * by_depth
        gu, gv = -by_hit * U * inverse, -by_hit * V * inverse
        gz = depth * inverse if hit else ZERO
        gd = -((gu * U + gv * V) * inverse + gz * z)
        gx = by_miss * dx - (u[1] * gu + v[1] * gv + d[1] * gd)
        gy = by_miss * dy - (u[2] * gu + v[2] * gv + d[2] * gd)
        red += weight * by_red
        green += weight * by_green
        blue += weight * by_blue
        sx += gx
        sy += gy
        ax += abs(gx)
        ay += abs(gy)
        su += gu
        sux += gu * x
        suy += gu * y
        sv += gv
        svx += gv * x
        svy += gv * y
        sd += gd
        sdx += gd * x
        sdy += gd * y
        sz += gz
        sz0 += ZERO if hit else depth
        so += h
        snx += weight * by_x
        sny += weight * by_y
        snz += weight * by_z
    moments = su, sux, suy, sv, svx, svy, sd, sdx, sdy
    return (red, green, blue, sx, sy), moments, (sz, sz0, so, snx, sny, snz, ax, ay)


@inner
def _read_tile(planes, left, top, image, colour, depth, alpha, normals):  # type: ignore[no-untyped-def]
    """Initialise a tile for the backward; pixels outside the image have T = 0 and gradients 0."""
    height, width = depth.shape[1], depth.shape[2]
    planes[: 10 * PIXELS] = ZERO
    for j in range(min(TILE, height - top)):
        for i in range(min(TILE, width - left)):
            p, y, x = j * TILE + i, top + j, left + i
            opacity = image.alpha[0, y, x]
            by_alpha, by_sum, total = alpha[0, y, x], ZERO, ZERO
            length = np.sqrt(image.summed[0, y, x] ** 2 + image.summed[1, y, x] ** 2 + image.summed[2, y, x] ** 2)
            if opacity >= SMALLEST_OPACITY:
                by_sum = depth[0, y, x] / opacity
                by_alpha -= by_sum * image.depth[0, y, x]
                if length > _FAINT:
                    along = ZERO
                    for c in range(3):
                        along += normals[c, y, x] * image.normals[c, y, x]
                    for c in range(3):
                        by_normal = (normals[c, y, x] - along * image.normals[c, y, x]) / length
                        planes[(7 + c) * PIXELS + p] = by_normal
                        total += by_normal * image.summed[c, y, x]
            for c in range(3):
                planes[(2 + c) * PIXELS + p] = colour[c, y, x]
                total += colour[c, y, x] * image.colour[c, y, x]
            planes[p] = ONE
            planes[PIXELS + p] = total + opacity * (by_sum * image.depth[0, y, x] + by_alpha)
            planes[5 * PIXELS + p] = by_sum
            planes[6 * PIXELS + p] = by_alpha


@inner
def _store_gradients(row, ends, moments, offset):  # type: ignore[no-untyped-def]
    """Write an entry's gradients; moments about the tile's first pixel become moments about the disk's centre."""
    (red, green, blue, sx, sy), (sz, sz0, so, snx, sny, snz, ax, ay) = ends
    su, sux, suy, sv, svx, svy, sd, sdx, sdy = moments
    dx, dy = offset
    row[0], row[1], row[2], row[3], row[4] = red, green, blue, sx, sy
    row[5], row[6] = sux + dx * su, suy + dy * su
    row[7], row[8] = svx + dx * sv, svy + dy * sv
    row[9], row[10], row[11] = sd, sdx + dx * sd, sdy + dy * sd
    row[12], row[13], row[14] = sz, sz0, so
    row[15], row[16], row[17], row[18], row[19] = snx, sny, snz, ax, ay


@kernel
def _blend_backward(splats, lists, image, colour, depth, alpha, normals, threads):  # type: ignore[no-untyped-def]
    height, width = depth.shape[1], depth.shape[2]
    down, across = -(-height // TILE), -(-width // TILE)
    gradients = np.empty((len(lists.gaussians), GRADIENT_COLUMNS), np.float32)
    near = np.float32(splats.near)
    for thread in prange(threads):
        planes = np.empty(12 * PIXELS, np.float32)
        coordinates(planes, 10)
        for tile in range(thread, down * across, threads):
            left, top = tile % across * TILE, tile // across * TILE
            _read_tile(planes, left, top, image, colour, depth, alpha, normals)
            start, end = lists.tile_starts[tile], lists.tile_starts[tile + 1]
            for e in range(start + image.blended_counts[tile], end):
                gradients[lists.slots[e]] = ZERO
            for e in range(start, start + image.blended_counts[tile]):
                g = lists.gaussians[e]
                u, v, d, offset, hit_z = _linear_forms(splats, g, left, top)
                first_pixel, end_pixel = np.uint64(TILE * lists.rows[e, 0]), np.uint64(TILE * lists.rows[e, 1])
                tint = splats.colours[g, 0], splats.colours[g, 1], splats.colours[g, 2]
                normal = splats.normals[g, 0], splats.normals[g, 1], splats.normals[g, 2]
                z0, peak = splats.depths[g], splats.peaks[g]
                head, moments, tail = _row_gradients(
                    planes, first_pixel, end_pixel, u, v, d, offset, hit_z, z0, near, peak, tint, normal
                )
                _store_gradients(gradients[lists.slots[e]], (head, tail), moments, offset)
    return gradients
