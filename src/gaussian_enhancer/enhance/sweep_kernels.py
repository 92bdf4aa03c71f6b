"""Compiled search of depth around a rendered surface: what `depth.search` does, without its memory traffic.

Axes: h height, w width, m multipliers of depth. Images are (h, w, 3) float32 here; costs (h, w, m), so that a pixel's
hypotheses lie together and are worked on as one vector.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.splat.compiled import inner, kernel

_F = np.float32


@kernel
@no_type_check
def add_differences(depth, multipliers, matrix, offset, across, down, in_front, photo, image, cost, weight):
    """Add one photo's mean absolute colour difference to each hypothesis, and 1 to the weight of those it shows."""
    height, width, count = cost.shape
    for y in prange(height):
        b = _F(y) + _F(0.5)
        for x in range(width):
            a = _F(x) + _F(0.5)
            across_slope = matrix[0, 0] * a + matrix[0, 1] * b + matrix[0, 2]
            down_slope = matrix[1, 0] * a + matrix[1, 1] * b + matrix[1, 2]
            far_slope = matrix[2, 0] * a + matrix[2, 1] * b + matrix[2, 2]
            for k in range(count):
                z = depth[y, x] * multipliers[k]
                far = z * far_slope + offset[2]
                if far <= in_front * z:
                    continue
                u = (z * across_slope + offset[0]) / far
                v = (z * down_slope + offset[1]) / far
                if u >= 0 and u <= across and v >= 0 and v <= down:
                    cost[y, x, k] += _difference(photo, u - _F(0.5), v - _F(0.5), image[y, x])
                    weight[y, x, k] += _F(1)


@inner
@no_type_check
def _difference(photo, u, v, colour):
    """Mean absolute difference of a colour to a photo read bilinearly; beyond the border, the border's colours."""
    rows, columns = photo.shape[0], photo.shape[1]
    u, v = min(max(u, _F(0)), _F(columns - 1)), min(max(v, _F(0)), _F(rows - 1))
    x0, y0 = int(u), int(v)
    x1, y1 = min(x0 + 1, columns - 1), min(y0 + 1, rows - 1)
    fx, fy = u - _F(x0), v - _F(y0)
    total = _F(0)
    for c in range(3):
        top = photo[y0, x0, c] + fx * (photo[y0, x1, c] - photo[y0, x0, c])
        bottom = photo[y1, x0, c] + fx * (photo[y1, x1, c] - photo[y1, x0, c])
        total += abs(top + fy * (bottom - top) - colour[c])
    return total / _F(3)


@kernel
@no_type_check
def find_valleys(cost, weight, steps, penalty, radius, best):
    """Sum costs over windows and write each pixel's cheapest step, refined by a parabola; 0 where nothing is seen."""
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
        mean = np.empty(count, np.float32)
        for x in range(width):
            left, right = max(0, x - radius), min(width, x + radius + 1)
            area = _F((below - above) * (right - left))
            seen = _mean_costs(column_cost, column_weight, left, right, area, steps, penalty, mean)
            best[y, x] = _valley(mean, steps) if seen else _F(0)


@inner
@no_type_check
def _mean_costs(column_cost, column_weight, left, right, area, steps, penalty, mean):
    """Mean cost of each hypothesis over a window plus its penalty; whether the rendered depth itself is seen."""
    count = len(steps)
    seen = False
    for k in range(count):
        total, share = _F(0), _F(0)
        for i in range(left, right):
            total += column_cost[i, k]
            share += column_weight[i, k]
        visible = share > _F(0.1) * area
        mean[k] = total / share + penalty * abs(steps[k]) if visible else _F(1)
        if k == count // 2:
            seen = visible
    return seen


@inner
@no_type_check
def _valley(mean, steps):
    """The step of least cost, moved to the minimum of the parabola through it and its neighbours."""
    index = min(max(int(np.argmin(mean)), 1), len(steps) - 2)
    before, here, after = mean[index - 1], mean[index], mean[index + 1]
    curvature = before - _F(2) * here + after
    shift = _F(0)
    if curvature > _F(1e-9):
        shift = min(max(_F(0.5) * (before - after) / curvature, _F(-1)), _F(1))
    return steps[index] + shift * (steps[1] - steps[0])
