"""Compiled search of depth around a rendered surface: what `depth.search` does, without its memory traffic.

Axes: h height, w width, m multipliers of depth. Images are (h, w, channels) float32 here; costs (h, w, m), so that a
pixel's hypotheses lie together and are worked on as one vector.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.splat.compiled import inner, kernel

_F = np.float32


SUMS = 6
"""What a hypothesis adds up over views: their count, photos' differences by channel, their squares, and renders'."""


@kernel
@no_type_check
def add_view(depth, multipliers, matrix, offset, across, down, in_front, both, counts, image, sums):
    """Add what one view shows of each hypothesis to its sums; ``both`` holds a photo's and a render's colours."""
    height, width, hypotheses = sums.shape[0], sums.shape[1], sums.shape[2]
    for y in prange(height):
        b = _F(y) + _F(0.5)
        for x in range(width):
            if counts[y, x] == 0:
                continue
            a = _F(x) + _F(0.5)
            across_slope = matrix[0, 0] * a + matrix[0, 1] * b + matrix[0, 2]
            down_slope = matrix[1, 0] * a + matrix[1, 1] * b + matrix[1, 2]
            far_slope = matrix[2, 0] * a + matrix[2, 1] * b + matrix[2, 2]
            for k in range(hypotheses):
                z = depth[y, x] * multipliers[k]
                far = z * far_slope + offset[2]
                if far <= in_front * z:
                    continue
                u = (z * across_slope + offset[0]) / far
                v = (z * down_slope + offset[1]) / far
                if u >= 0 and u <= across and v >= 0 and v <= down:
                    _add_colours(both, u - _F(0.5), v - _F(0.5), image[y, x], sums[y, x, k])


@inner
@no_type_check
def _add_colours(both, u, v, colour, sums):
    """Add the differences of two images, read bilinearly, to a colour; beyond the border, the border's colours."""
    rows, columns = both.shape[0], both.shape[1]
    u, v = min(max(u, _F(0)), _F(columns - 1)), min(max(v, _F(0)), _F(rows - 1))
    x0, y0 = int(u), int(v)
    x1, y1 = min(x0 + 1, columns - 1), min(y0 + 1, rows - 1)
    fx, fy = u - _F(x0), v - _F(y0)
    sums[0] += _F(1)
    for c in range(3):
        away = _between(both[y0, x0, c], both[y0, x1, c], both[y1, x0, c], both[y1, x1, c], fx, fy) - colour[c]
        sums[1 + c] += away
        sums[4] += away * away / _F(3)
    for c in range(3, 6):
        read = _between(both[y0, x0, c], both[y0, x1, c], both[y1, x0, c], both[y1, x1, c], fx, fy)
        sums[5] += abs(read - colour[c - 3]) / _F(3)


@inner
@no_type_check
def _between(a, b, c, d, fx, fy):
    top, bottom = a + fx * (b - a), c + fx * (d - c)
    return top + fy * (bottom - top)


@kernel
@no_type_check
def mean_costs(sums, inconsistency, tiny, cost, weight):
    """Write each hypothesis's cost, and 1 as its weight where a view sees it, 0 elsewhere."""
    for y in prange(cost.shape[0]):
        for x in range(cost.shape[1]):
            for k in range(cost.shape[2]):
                seen = sums[y, x, k]
                n = seen[0]
                if n == 0:
                    cost[y, x, k] = weight[y, x, k] = _F(0)
                    continue
                mean = seen[5] / n
                spread = mean
                if n > 1:
                    total = (seen[1] * seen[1] + seen[2] * seen[2] + seen[3] * seen[3]) / (_F(3) * n)
                    spread = np.sqrt(max(seen[4] - total, _F(0)) / (n - _F(1)) + tiny)
                cost[y, x, k] = mean + inconsistency * spread
                weight[y, x, k] = _F(1)


@kernel
@no_type_check
def find_valleys(cost, weight, steps, penalty, dearest, radius, best):
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
            seen = _window_costs(column_cost, column_weight, left, right, area, steps, penalty, dearest, mean)
            best[y, x] = _valley(mean, steps) if seen else _F(0)


@inner
@no_type_check
def _window_costs(column_cost, column_weight, left, right, area, steps, penalty, dearest, mean):
    """Mean cost of each hypothesis over a window plus its penalty; whether the rendered depth itself is seen."""
    count = len(steps)
    seen = False
    for k in range(count):
        total, share = _F(0), _F(0)
        for i in range(left, right):
            total += column_cost[i, k]
            share += column_weight[i, k]
        visible = share > _F(0.1) * area
        mean[k] = total / share + penalty * abs(steps[k]) if visible else dearest
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
