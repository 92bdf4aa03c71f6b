"""Compiled depth search around a rendered surface: the same as `depth_search.search_torch`, with less memory traffic.

Axes: h height, w width, m multipliers of depth. Images are (h, w, channels) float32 here. Costs are (h, w, m), so that
the hypotheses of a pixel are contiguous and processed as one vector.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.compiled import inner, kernel

_F = np.float32
_NEXT = np.uint64(1)
_ZERO, _ONE, _THREE, _HALF = _F(0), _F(1), _F(3), _F(0.5)


@kernel
@no_type_check
def pack(photo, render, transform, result):
    """Write the pixels of a photo and a render as six channels, (h, w, 6), each gain x colour + offset."""
    _, height, width = photo.shape
    for y in prange(height):
        for x in range(width):
            for c in range(3):
                gain, offset = transform[c, 0], transform[c, 1]
                result[y, x, c] = gain * photo[c, y, x] + offset
                result[y, x, 3 + c] = gain * render[c, y, x] + offset


@kernel
@no_type_check
def find_costs(
    depth,
    multipliers,
    matrices,
    offsets,
    sizes,
    starts,
    min_relative_z,
    images,
    mask,
    image,
    inconsistency,
    variance_epsilon,
    cost,
    weight,
):
    """Write the cost of each hypothesis and its weight: 1 if it is visible in a reference, else 0.

    ``images`` holds the pixels of all references one after the other, with photo and render as six channels. Reference
    r begins at pixel starts[r] and has sizes[r] = (width, height) and an extra row. All references are read in one loop
    for each hypothesis, so that its sums stay in registers.
    """
    height, width, hypotheses = cost.shape
    views = len(starts)
    for y in prange(height):
        pixel = np.empty((views, hypotheses), np.int64)
        across, down = np.empty((2, views, hypotheses), np.float32)
        visible = np.empty((views, hypotheses), np.float32)
        for x in range(width):
            for r in range(views):
                position = _F(x) + _HALF, _F(y) + _HALF
                _write_projections(
                    depth[y, x], multipliers, matrices[r], offsets[r], position, sizes[r], starts[r], min_relative_z,
                    mask[r, y, x], pixel[r], across[r], down[r], visible[r],
                )  # fmt: skip
            red, green, blue = image[y, x, 0], image[y, x, 1], image[y, x, 2]
            for k in range(hypotheses):
                n, squares, difference = _ZERO, _ZERO, _ZERO
                total0, total1, total2 = _ZERO, _ZERO, _ZERO
                for r in range(views):
                    if visible[r, k] == _ZERO:
                        continue
                    p, fx, fy = np.uint64(pixel[r, k]), across[r, k], down[r, k]
                    q = p + np.uint64(sizes[r, 0])
                    deviation0 = _interpolate_channel(images, p, q, 0, fx, fy) - red
                    deviation1 = _interpolate_channel(images, p, q, 1, fx, fy) - green
                    deviation2 = _interpolate_channel(images, p, q, 2, fx, fy) - blue
                    n += _ONE
                    total0, total1, total2 = total0 + deviation0, total1 + deviation1, total2 + deviation2
                    squares += deviation0 * deviation0 + deviation1 * deviation1 + deviation2 * deviation2
                    difference += abs(_interpolate_channel(images, p, q, 3, fx, fy) - red)
                    difference += abs(_interpolate_channel(images, p, q, 4, fx, fy) - green)
                    difference += abs(_interpolate_channel(images, p, q, 5, fx, fy) - blue)
                cost[y, x, k] = weight[y, x, k] = _ZERO
                if n > _ZERO:
                    total = total0 * total0 + total1 * total1 + total2 * total2
                    mean = difference / (_THREE * n)
                    variance = max(squares - total / n, _ZERO) / (_THREE * max(n - _ONE, _ONE))
                    spread = np.sqrt(variance + variance_epsilon) if n > _ONE else mean
                    cost[y, x, k] = mean + inconsistency * spread
                    weight[y, x, k] = _ONE


@inner
@no_type_check
def _write_projections(
    depth, multipliers, matrix, offset, position, size, start, min_relative_z, mask, pixel, across, down, visible
):
    """Write the projection of each hypothesis: upper left pixel, fractional offset from it, and 1 where visible."""
    a, b = position
    width, height = _F(size[0]), _F(size[1])
    x_slope = matrix[0, 0] * a + matrix[0, 1] * b + matrix[0, 2]
    y_slope = matrix[1, 0] * a + matrix[1, 1] * b + matrix[1, 2]
    z_slope = matrix[2, 0] * a + matrix[2, 1] * b + matrix[2, 2]
    for k in range(len(multipliers)):
        z = depth * multipliers[k]
        reference_z = z * z_slope + offset[2]
        in_front = reference_z > min_relative_z * z
        inverse_z = _ONE / (reference_z if in_front else _ONE)
        u, v = (z * x_slope + offset[0]) * inverse_z, (z * y_slope + offset[1]) * inverse_z
        is_visible = in_front and u >= _ZERO and u <= width and v >= _ZERO and v <= height and mask > _ZERO
        u, v = min(max(u - _HALF, _ZERO), width - _ONE), min(max(v - _HALF, _ZERO), height - _ONE)
        column, row = np.int32(u), np.int32(v)
        across[k], down[k], visible[k] = u - _F(column), v - _F(row), _ONE if is_visible else _ZERO
        pixel[k] = start + row * size[0] + column


@inner
@no_type_check
def _interpolate_channel(images, p, q, channel, fx, fy):
    """Interpolate one channel between four pixels: p, q and their right neighbours. Outside pixels have weight zero."""
    above, below = images[p, channel], images[q, channel]
    top = above + fx * (images[p + _NEXT, channel] - above)
    bottom = below + fx * (images[q + _NEXT, channel] - below)
    return top + fy * (bottom - top)


@kernel
@no_type_check
def find_cost_minima(cost, weight, steps, penalty, invisible_cost, radius, best):
    """Average costs over windows; write each pixel's step of least cost, refined by a parabola; 0 if not visible."""
    height, width, count = cost.shape
    for y in prange(height):
        above, below = max(0, y - radius), min(height, y + radius + 1)
        column_cost = np.zeros((width, count), np.float32)
        column_weight = np.zeros((width, count), np.float32)
        for j in range(above, below):
            for x in range(width):
                for k in range(count):
                    column_cost[x, k] += cost[j, x, k]
                    column_weight[x, k] += weight[j, x, k]
        mean, share = np.empty((2, count), np.float32)
        for x in range(width):
            left, right = max(0, x - radius), min(width, x + radius + 1)
            area = _F((below - above) * (right - left))
            visible = _window_costs(
                column_cost, column_weight, left, right, area, steps, penalty, invisible_cost, mean, share
            )
            best[y, x] = _refine_minimum(mean, steps) if visible else _F(0)


@inner
@no_type_check
def _window_costs(column_cost, column_weight, left, right, area, steps, penalty, invisible_cost, mean, share):
    """Mean cost of each hypothesis over a window plus its penalty; return whether the rendered depth is visible."""
    count = len(steps)
    mean[:], share[:] = 0, 0
    for i in range(left, right):
        for k in range(count):
            mean[k] += column_cost[i, k]
            share[k] += column_weight[i, k]
    for k in range(count):
        visible = share[k] > _F(0.1) * area
        mean[k] = mean[k] / share[k] + penalty * abs(steps[k]) if visible else invisible_cost
    return share[count // 2] > _F(0.1) * area


@inner
@no_type_check
def _refine_minimum(mean, steps):
    """The step of least cost, refined to the minimum of a parabola through it and its neighbours."""
    index = min(max(int(np.argmin(mean)), 1), len(steps) - 2)
    before, centre, after = mean[index - 1], mean[index], mean[index + 1]
    curvature = before - _F(2) * centre + after
    shift = _F(0)
    if curvature > _F(1e-9):
        shift = min(max(_F(0.5) * (before - after) / curvature, _F(-1)), _F(1))
    return steps[index] + shift * (steps[1] - steps[0])
