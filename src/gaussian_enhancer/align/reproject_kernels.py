"""Compiled warp of references: the per-pixel operations of `projection` and `alignment`, with less memory traffic.

Axes: h height, w width of the target; p, q of a reference's image. Images are (channels, height, width) float32.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.compiled import exp2_nonpositive, inner, kernel

_F = np.float32
_HALF, _ONE, _ZERO = _F(0.5), _F(1), _F(0)
_LOG2E = _F(1.4426950408889634)
_TINY = _F(np.finfo(np.float32).tiny)


@kernel
@no_type_check
def project_pixels(depth, matrix, offset, width, height, min_relative_z, columns, rows, inside):
    """Write the projection of each pixel into a reference of ``width`` x ``height`` pixels, and 1 where inside."""
    for y in prange(depth.shape[0]):
        for x in range(depth.shape[1]):
            u, v, _, is_inside = _project_pixel(x, y, depth[y, x], matrix, offset, width, height, min_relative_z)
            columns[y, x], rows[y, x], inside[y, x] = u, v, _ONE if is_inside else _ZERO


@kernel
@no_type_check
def depth_agreement(depth, matrix, offset, width, height, min_relative_z, reference_depth, tolerance, result):
    """Write exp(-((z - z') / (tolerance z))^2 / 2), z' being ``reference_depth`` at the nearest pixel; 1 if z' is 0."""
    depth_height, depth_width = reference_depth.shape
    for y in prange(depth.shape[0]):
        for x in range(depth.shape[1]):
            u, v, z, _ = _project_pixel(x, y, depth[y, x], matrix, offset, width, height, min_relative_z)
            column = _nearest_pixel(u * (_F(depth_width) / width), depth_width)
            row = _nearest_pixel(v * (_F(depth_height) / height), depth_height)
            expected_depth = reference_depth[row, column]
            difference = (z - expected_depth) / (tolerance * max(z, _TINY))
            # Rounding may exceed 1.
            consistency = min(exp2_nonpositive(-_HALF * _LOG2E * difference * difference), _ONE)
            result[y, x] = consistency if expected_depth > _ZERO else _ONE


@inner
@no_type_check
def _project_pixel(x, y, depth, matrix, offset, width, height, min_relative_z):
    """Column, row and z in the reference of a target pixel at a depth, and whether it is inside and in front."""
    a, b = _F(x) + _HALF, _F(y) + _HALF
    z = depth * (matrix[2, 0] * a + matrix[2, 1] * b + matrix[2, 2]) + offset[2]
    in_front = z > min_relative_z * depth
    inverse_z = _ONE / z if in_front else _ONE
    u = (depth * (matrix[0, 0] * a + matrix[0, 1] * b + matrix[0, 2]) + offset[0]) * inverse_z
    v = (depth * (matrix[1, 0] * a + matrix[1, 1] * b + matrix[1, 2]) + offset[1]) * inverse_z
    return u, v, z, in_front and u >= _ZERO and u <= width and v >= _ZERO and v <= height


@inner
@no_type_check
def _nearest_pixel(position, count):
    """Index of the pixel that contains a position in pixels, clamped to the border."""
    return int(np.rint(min(max(position - _HALF, _ZERO), _F(count - 1))))


@kernel
@no_type_check
def sample_bilinear(image, columns, rows, across, down, where, result):
    """Write samples of an image at (columns x across, rows x down), bilinear; 0 where ``where`` is not positive."""
    channels, height, width = image.shape
    for y in prange(where.shape[0]):
        for x in range(where.shape[1]):
            if where[y, x] > _ZERO:
                u = min(max(columns[y, x] * across - _HALF, _ZERO), _F(width - 1))
                v = min(max(rows[y, x] * down - _HALF, _ZERO), _F(height - 1))
                x0, y0 = int(u), int(v)
                x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
                fx, fy = u - _F(x0), v - _F(y0)
                for c in range(channels):
                    p, q, r, t = _F(image[c, y0, x0]), _F(image[c, y0, x1]), _F(image[c, y1, x0]), _F(image[c, y1, x1])
                    top, bottom = p + fx * (q - p), r + fx * (t - r)
                    result[c, y, x] = top + fy * (bottom - top)
            else:
                for c in range(channels):
                    result[c, y, x] = _ZERO


@inner
@no_type_check
def _cubic_weights(f):
    """Weights of Keys' cubic convolution (1981), a = -3/4, for the four samples around a fractional position ``f``."""
    g = _ONE - f
    a = _F(-0.75)
    far = a * f * g * g
    near = _ONE - f * f * ((a + _F(3)) - (a + _F(2)) * f)
    next_ = _ONE - g * g * ((a + _F(3)) - (a + _F(2)) * g)
    return far, near, next_, a * g * f * f


@inner
@no_type_check
def _four_samples(position, count):
    """Indices of the four samples around a position, unsigned to avoid negative indexing, and their weights."""
    position = min(max(position, -_ONE), _F(count))
    first = int(np.floor(position))
    far, near, next_, last = _cubic_weights(position - _F(first))
    return (
        np.uint64(min(max(first - 1, 0), count - 1)),
        np.uint64(min(max(first, 0), count - 1)),
        np.uint64(min(first + 1, count - 1)),
        np.uint64(min(first + 2, count - 1)),
        far,
        near,
        next_,
        last,
    )


@kernel
@no_type_check
def sample_bicubic(image, columns, rows, across, down, where, result):
    """As `sample_bilinear`, by cubic convolution clamped to [0, 1]; outside the image, the border's values are used."""
    channels, height, width = image.shape
    for y in prange(where.shape[0]):
        for x in range(where.shape[1]):
            if where[y, x] > _ZERO:
                i0, i1, i2, i3, a0, a1, a2, a3 = _four_samples(columns[y, x] * across - _HALF, width)
                j0, j1, j2, j3, b0, b1, b2, b3 = _four_samples(rows[y, x] * down - _HALF, height)
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
def sample_bicubic_pair(first, second, columns, rows, across, down, where, first_result, second_result):
    """`sample_bicubic` of two images of the same size, whose channels are interleaved and processed as one vector."""
    channels, height, width = first.shape
    pixels = np.zeros((height, width, 8), np.float32)
    for y in prange(height):
        for x in range(width):
            for c in range(channels):
                pixels[y, x, c], pixels[y, x, 4 + c] = first[c, y, x], second[c, y, x]
    for y in prange(where.shape[0]):
        total = np.empty(8, np.float32)
        for x in range(where.shape[1]):
            if where[y, x] > _ZERO:
                i0, i1, i2, i3, a0, a1, a2, a3 = _four_samples(columns[y, x] * across - _HALF, width)
                j0, j1, j2, j3, b0, b1, b2, b3 = _four_samples(rows[y, x] * down - _HALF, height)
                for c in range(8):
                    r0 = a0 * pixels[j0, i0, c] + a1 * pixels[j0, i1, c]
                    r0 += a2 * pixels[j0, i2, c] + a3 * pixels[j0, i3, c]
                    r1 = a0 * pixels[j1, i0, c] + a1 * pixels[j1, i1, c]
                    r1 += a2 * pixels[j1, i2, c] + a3 * pixels[j1, i3, c]
                    r2 = a0 * pixels[j2, i0, c] + a1 * pixels[j2, i1, c]
                    r2 += a2 * pixels[j2, i2, c] + a3 * pixels[j2, i3, c]
                    r3 = a0 * pixels[j3, i0, c] + a1 * pixels[j3, i1, c]
                    r3 += a2 * pixels[j3, i2, c] + a3 * pixels[j3, i3, c]
                    total[c] = min(max(b0 * r0 + b1 * r1 + b2 * r2 + b3 * r3, _ZERO), _ONE)
                for c in range(channels):
                    first_result[c, y, x], second_result[c, y, x] = total[c], total[4 + c]
            else:
                for c in range(channels):
                    first_result[c, y, x] = second_result[c, y, x] = _ZERO


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
        columns = np.zeros((2, width + 2 * radius), np.float32)
        for j in range(above, below):
            _add(columns[0, radius : radius + width], weighted[j])
            _add(columns[1, radius : radius + width], visibility[j])
        sums = np.zeros((2, width), np.float32)
        for i in range(2 * radius + 1):
            _add(sums[0], columns[0, i : i + width])
            _add(sums[1], columns[1, i : i + width])
        for x in range(width):
            count = min(width, x + radius + 1) - max(0, x - radius)
            min_visibility = _F(1e-6) * _F((below - above) * count)
            result[y, x] = sums[0, x] / max(sums[1, x], min_visibility)


@inner
@no_type_check
def _add(total, values):
    for x in range(len(total)):
        total[x] += values[x]


@kernel
@no_type_check
def finish_fine(colour, visibility, transform, coarse, top, result):
    """Rows of a fine image: gain x colour + offset within [0, 1] where visible, else the coarse image's colour.

    Args:
        colour: colours of the rows, (3, s, 4 w).
        visibility: visibility of the rows, (s, 4 w).
        transform: gain and offset of each channel.
        coarse: colours of the coarse image, (3, h, w).
        top: index of the first row in the fine image, a multiple of 4.
        result: output, (3, s, 4 w).
    """
    channels, height, _ = colour.shape
    for y in prange(height):
        for c in range(channels):
            gain, offset = transform[c, 0], transform[c, 1]
            _finish_row(colour[c, y], visibility[y], gain, offset, coarse[c, (top + y) // 4], result[c, y])


@inner
@no_type_check
def _finish_row(colour, visibility, gain, offset, coarse, result):
    for x in range(len(colour)):
        value = min(max(gain * colour[x] + offset, _ZERO), _ONE)
        result[x] = value if visibility[x] > _ZERO else coarse[x // 4]
