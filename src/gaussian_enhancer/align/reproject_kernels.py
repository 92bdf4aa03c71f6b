"""Compiled warp of references: what `projection` and `alignment` do per pixel, without their memory traffic.

Axes: h height, w width of the target; p, q of a reference's image. Images are (channels, height, width) float32.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.splat.compiled import inner, kernel

_F = np.float32
_HALF, _ONE, _ZERO = _F(0.5), _F(1), _F(0)
_TINY = _F(np.finfo(np.float32).tiny)


@kernel
@no_type_check
def land(depth, matrix, offset, width, height, in_front, columns, rows, inside):
    """Write where each pixel lands in a reference of ``width`` x ``height`` pixels, and 1 where that is inside."""
    for y in prange(depth.shape[0]):
        for x in range(depth.shape[1]):
            u, v, _, ok = _landing(x, y, depth[y, x], matrix, offset, width, height, in_front)
            columns[y, x], rows[y, x], inside[y, x] = u, v, _ONE if ok else _ZERO


@kernel
@no_type_check
def check(depth, matrix, offset, width, height, in_front, seen, tolerance, result):
    """Write exp(-((z - z') / (tolerance z))^2 / 2), z' being ``seen`` at the nearest pixel; 1 where that is 0."""
    high, wide = seen.shape
    for y in prange(depth.shape[0]):
        for x in range(depth.shape[1]):
            u, v, z, _ = _landing(x, y, depth[y, x], matrix, offset, width, height, in_front)
            column = _nearest(u * (_F(wide) / width), wide)
            row = _nearest(v * (_F(high) / height), high)
            there = seen[row, column]
            difference = (z - there) / (tolerance * max(z, _TINY))
            result[y, x] = _F(np.exp(-_HALF * difference * difference)) if there > _ZERO else _ONE


@inner
@no_type_check
def _landing(x, y, depth, matrix, offset, width, height, in_front):
    """Column, row and z in the reference of a target's pixel at a depth, and whether inside and in front."""
    a, b = _F(x) + _HALF, _F(y) + _HALF
    z = depth * (matrix[2, 0] * a + matrix[2, 1] * b + matrix[2, 2]) + offset[2]
    ahead = z > in_front * depth
    share = _ONE / z if ahead else _ONE
    u = (depth * (matrix[0, 0] * a + matrix[0, 1] * b + matrix[0, 2]) + offset[0]) * share
    v = (depth * (matrix[1, 0] * a + matrix[1, 1] * b + matrix[1, 2]) + offset[1]) * share
    return u, v, z, ahead and u >= _ZERO and u <= width and v >= _ZERO and v <= height


@inner
@no_type_check
def _nearest(position, count):
    """The pixel that a position in pixels lies in, the outermost beyond the border."""
    return int(np.rint(min(max(position - _HALF, _ZERO), _F(count - 1))))


@kernel
@no_type_check
def read(image, columns, rows, across, down, where, result):
    """Read an image bilinearly at (columns x across, rows x down); write 0 where ``where`` is not positive."""
    channels, high, wide = image.shape
    for y in prange(where.shape[0]):
        for x in range(where.shape[1]):
            if where[y, x] > _ZERO:
                u = min(max(columns[y, x] * across - _HALF, _ZERO), _F(wide - 1))
                v = min(max(rows[y, x] * down - _HALF, _ZERO), _F(high - 1))
                x0, y0 = int(u), int(v)
                x1, y1 = min(x0 + 1, wide - 1), min(y0 + 1, high - 1)
                fx, fy = u - _F(x0), v - _F(y0)
                for c in range(channels):
                    top = image[c, y0, x0] + fx * (image[c, y0, x1] - image[c, y0, x0])
                    bottom = image[c, y1, x0] + fx * (image[c, y1, x1] - image[c, y1, x0])
                    result[c, y, x] = top + fy * (bottom - top)
            else:
                for c in range(channels):
                    result[c, y, x] = _ZERO


@inner
@no_type_check
def _cubic(f):
    """Weights of Keys' cubic convolution (1981) with a = -3/4 for the four samples around a fraction ``f``."""
    g = _ONE - f
    a = _F(-0.75)
    far = a * f * g * g
    near = _ONE - f * f * ((a + _F(3)) - (a + _F(2)) * f)
    next_ = _ONE - g * g * ((a + _F(3)) - (a + _F(2)) * g)
    return far, near, next_, a * g * f * f


@kernel
@no_type_check
def read_cubic(image, columns, rows, across, down, where, result):
    """The same by cubic convolution, kept within [0, 1]; samples beyond the border are the border's."""
    channels, high, wide = image.shape
    for y in prange(where.shape[0]):
        for x in range(where.shape[1]):
            if where[y, x] > _ZERO:
                u = min(max(columns[y, x] * across - _HALF, -_ONE), _F(wide))
                v = min(max(rows[y, x] * down - _HALF, -_ONE), _F(high))
                left, above = int(np.floor(u)), int(np.floor(v))
                a0, a1, a2, a3 = _cubic(u - _F(left))
                b0, b1, b2, b3 = _cubic(v - _F(above))
                i0, i1 = min(max(left - 1, 0), wide - 1), min(max(left, 0), wide - 1)
                i2, i3 = min(left + 1, wide - 1), min(left + 2, wide - 1)
                j0, j1 = min(max(above - 1, 0), high - 1), min(max(above, 0), high - 1)
                j2, j3 = min(above + 1, high - 1), min(above + 2, high - 1)
                for c in range(channels):
                    p = image[c]
                    r0 = a0 * p[j0, i0] + a1 * p[j0, i1] + a2 * p[j0, i2] + a3 * p[j0, i3]
                    r1 = a0 * p[j1, i0] + a1 * p[j1, i1] + a2 * p[j1, i2] + a3 * p[j1, i3]
                    r2 = a0 * p[j2, i0] + a1 * p[j2, i1] + a2 * p[j2, i2] + a3 * p[j2, i3]
                    r3 = a0 * p[j3, i0] + a1 * p[j3, i1] + a2 * p[j3, i2] + a3 * p[j3, i3]
                    result[c, y, x] = min(max(b0 * r0 + b1 * r1 + b2 * r2 + b3 * r3, _ZERO), _ONE)
            else:
                for c in range(channels):
                    result[c, y, x] = _ZERO


@kernel
@no_type_check
def window_difference(colour, image, visibility, radius, result):
    """Write the mean absolute colour difference, weighted by visibility, over squares of 2 ``radius`` + 1 pixels."""
    channels, height, width = image.shape
    weighted = np.empty((height, width), np.float32)
    for y in prange(height):
        for x in range(width):
            total = _ZERO
            for c in range(channels):
                total += abs(colour[c, y, x] - image[c, y, x])
            weighted[y, x] = visibility[y, x] * total / _F(channels)
    for y in prange(height):
        above, below = max(0, y - radius), min(height, y + radius + 1)
        differences, shares = np.zeros(width, np.float32), np.zeros(width, np.float32)
        for j in range(above, below):
            for x in range(width):
                differences[x] += weighted[j, x]
                shares[x] += visibility[j, x]
        for x in range(width):
            left, right = max(0, x - radius), min(width, x + radius + 1)
            difference, share = _ZERO, _ZERO
            for i in range(left, right):
                difference += differences[i]
                share += shares[i]
            least = _F(1e-6) * _F((below - above) * (right - left))
            result[y, x] = difference / max(share, least)
