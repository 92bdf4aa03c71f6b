"""Compiled plane sweep: matching costs of a view at many inverse depths, smoothed and reduced to one depth a pixel.

Axes: d inverse depths, h height, w width, j neighbour views. Images are (h, w, 3) float32 here: a pixel's channels
are adjacent in memory. Costs are computed in parallel over planes, and smoothed in parallel over scanlines.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.compiled import exact_inner, exact_kernel

OUTSIDE_COST = np.float32(0.5)
"""Cost of a pixel outside a neighbour's image: that of a bad match, so that visible depths are preferred."""


@exact_inner
@no_type_check
def _difference(image, neighbour, homography, out):
    """Mean absolute difference over channels of the view and a neighbour warped by one plane's homography.

    It is at most `OUTSIDE_COST`.
    """
    height, width = image.shape[0], image.shape[1]
    for y in range(height):
        for x in range(width):
            u, v = np.float32(x + 0.5), np.float32(y + 0.5)
            depth = homography[2, 0] * u + homography[2, 1] * v + homography[2, 2]
            out[y, x] = OUTSIDE_COST
            if depth <= 1e-6:
                continue
            px = (homography[0, 0] * u + homography[0, 1] * v + homography[0, 2]) / depth - np.float32(0.5)
            py = (homography[1, 0] * u + homography[1, 1] * v + homography[1, 2]) / depth - np.float32(0.5)
            if not (0 <= px < neighbour.shape[1] - 1 and 0 <= py < neighbour.shape[0] - 1):
                continue
            x0, y0 = int(px), int(py)
            fx, fy = px - np.float32(x0), py - np.float32(y0)
            total = np.float32(0)
            for c in range(3):
                top = neighbour[y0, x0, c] + fx * (neighbour[y0, x0 + 1, c] - neighbour[y0, x0, c])
                bottom = neighbour[y0 + 1, x0, c] + fx * (neighbour[y0 + 1, x0 + 1, c] - neighbour[y0 + 1, x0, c])
                total += abs(top + fy * (bottom - top) - image[y, x, c])
            out[y, x] = min(OUTSIDE_COST, total / np.float32(3))


@exact_inner
@no_type_check
def _box(values, radius, out):
    """Mean over a window that is cropped at the borders, along rows first and then along columns."""
    height, width = values.shape
    rows = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            low, high = max(0, x - radius), min(width, x + radius + 1)
            total = np.float32(0)
            for k in range(low, high):
                total += values[y, k]
            rows[y, x] = total / np.float32(high - low)
    for y in range(height):
        low, high = max(0, y - radius), min(height, y + radius + 1)
        for x in range(width):
            out[y, x] = np.float32(0)
        for k in range(low, high):
            for x in range(width):
                out[y, x] += rows[k, x] / np.float32(high - low)


@exact_kernel
@no_type_check
def cost_volume(image, neighbours, homographies, radius, volume):
    """Windowed absolute differences, averaged over the better half of the neighbours: the rest may be occluded.

    Args: image (h, w, 3), neighbours (j, H, W, 3), homographies (d, j, 3, 3), volume (h, w, d) to fill.
    """
    height, width = image.shape[0], image.shape[1]
    views = neighbours.shape[0]
    used_count = (views + 1) // 2
    for plane in prange(homographies.shape[0]):
        raw = np.empty((height, width), np.float32)
        costs = np.empty((views, height, width), np.float32)
        for j in range(views):
            _difference(image, neighbours[j], homographies[plane, j], raw)
            _box(raw, radius, costs[j])
        sorted_costs = np.empty(views, np.float32)
        for y in range(height):
            for x in range(width):
                for j in range(views):
                    value, index = costs[j, y, x], j
                    while index > 0 and sorted_costs[index - 1] > value:
                        sorted_costs[index] = sorted_costs[index - 1]
                        index -= 1
                    sorted_costs[index] = value
                volume[y, x, plane] = sorted_costs[:used_count].sum() / used_count


@exact_inner
@no_type_check
def _path_costs(previous, cost, small, large, out):
    """Path costs of a pixel in semi-global matching: changes by one plane cost ``small``, larger ones ``large``."""
    planes = cost.shape[0]
    cheapest = previous.min()
    for d in range(planes):
        value = min(previous[d], cheapest + large)
        if d > 0:
            value = min(value, previous[d - 1] + small)
        if d < planes - 1:
            value = min(value, previous[d + 1] + small)
        out[d] = cost[d] + value - cheapest


@exact_kernel
@no_type_check
def aggregate_costs(volume, image, small, large, total):
    """Sums of semi-global path costs along rows and columns in both directions; jumps cost less at image edges.

    Source: Hirschmueller, Stereo Processing by Semiglobal Matching and Mutual Information, TPAMI 2008, eq. 13.
    """
    height, width, planes = volume.shape
    for direction in range(4):
        along_rows = direction < 2
        lines = height if along_rows else width
        length = width if along_rows else height
        for task in prange(lines):
            line = np.int64(task)  # an unsigned loop index would make position a float
            previous = np.zeros(planes, np.float32)
            current = np.empty(planes, np.float32)
            for step in range(length):
                position = step if direction % 2 == 0 else length - 1 - step
                y, x = (line, position) if along_rows else (position, line)
                penalty = large
                if step > 0:
                    previous_position = position - 1 if direction % 2 == 0 else position + 1
                    py, px = (line, previous_position) if along_rows else (previous_position, line)
                    edge = np.float32(0)
                    for c in range(3):
                        edge += abs(image[y, x, c] - image[py, px, c])
                    penalty = max(small, large / (np.float32(1) + np.float32(10) * edge))
                _path_costs(previous, volume[y, x], small, penalty, current)
                for d in range(planes):
                    total[y, x, d] += current[d]
                    previous[d] = current[d]


@exact_kernel
@no_type_check
def best_plane(volume, index):
    """Index of the cheapest plane of each pixel, refined between planes by a parabola through its neighbours."""
    height, width, planes = volume.shape
    for y in prange(height):
        for x in range(width):
            best = np.argmin(volume[y, x])
            index[y, x] = best
            if 0 < best < planes - 1:
                before, cost, after = volume[y, x, best - 1], volume[y, x, best], volume[y, x, best + 1]
                curvature = before - 2 * cost + after
                if curvature > 0:
                    index[y, x] = best + 0.5 * (before - after) / curvature
