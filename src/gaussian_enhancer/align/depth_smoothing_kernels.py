"""Compiled fit of planes to depth: the same as `depth_smoothing.fit_planes_torch`, by rows so that loops vectorise.

Axes: h height, w width; images are (channels, height, width) float32.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.compiled import add_scaled, inner, kernel

_F = np.float32
_ONE = _F(1)


@kernel
@no_type_check
def fit_planes(depth, render, step, radius, sharpness, contrast, ridge, max_ratio, result):
    """Write the relative offset of each pixel's fitted plane; depth and render have a margin of ``radius`` samples."""
    for y in prange(result.shape[0]):
        _fit_row(depth, render, y + radius * step, step, radius, sharpness, contrast, ridge, max_ratio, result[y])


@inner
@no_type_check
def _fit_row(depth, render, row, step, radius, sharpness, contrast, ridge, max_ratio, result):
    """Compute one row with loops that LLVM vectorises: over slices, with few arrays at a time and simple counters."""
    width, margin = len(result), radius * step
    centre_depth, end = depth[row, margin : margin + width], margin + width
    contrasts, weight = np.empty(width, np.float32), np.empty(width, np.float32)
    weighted_offset = np.empty(width, np.float32)
    sums, sums_of_row = np.zeros((9, width), np.float32), np.empty((5, width), np.float32)
    for j in range(-radius, radius + 1):
        sums_of_row[:] = 0
        for i in range(-radius, radius + 1):
            sample_row, left, right, dx = row + j * step, margin + i * step, end + i * step, _F(i)
            contrasts[:] = 0
            for c in range(3):
                _add_contrast(contrasts, render[c, sample_row, left:right], render[c, row, margin:end], contrast)
            sample_depth = depth[sample_row, left:right]
            _sample_weights(centre_depth, sample_depth, contrasts, sharpness, max_ratio, weight, weighted_offset)
            add_scaled(sums_of_row[0], weight, _ONE)
            add_scaled(sums_of_row[3], weighted_offset, _ONE)
            if i != 0:
                add_scaled(sums_of_row[1], weight, dx)
                add_scaled(sums_of_row[2], weight, dx * dx)
                add_scaled(sums_of_row[4], weighted_offset, dx)
        dy = _F(j)
        add_scaled(sums[0], sums_of_row[0], _ONE)
        add_scaled(sums[1], sums_of_row[1], _ONE)
        add_scaled(sums[3], sums_of_row[2], _ONE)
        add_scaled(sums[6], sums_of_row[3], _ONE)
        add_scaled(sums[7], sums_of_row[4], _ONE)
        if j != 0:
            add_scaled(sums[2], sums_of_row[0], dy)
            add_scaled(sums[4], sums_of_row[1], dy)
            add_scaled(sums[5], sums_of_row[0], dy * dy)
            add_scaled(sums[8], sums_of_row[3], dy)
    for x in range(width):
        count, sx, sy = sums[0, x], sums[1, x], sums[2, x]
        xx, xy, yy = sums[3, x] + ridge, sums[4, x], sums[5, x] + ridge
        area = xx * yy - xy * xy
        across, down = (sx * yy - sy * xy) / area, (sy * xx - sx * xy) / area
        divisor = count - across * sx - down * sy
        result[x] = (sums[6, x] - across * sums[7, x] - down * sums[8, x]) / divisor


@inner
@no_type_check
def _add_contrast(total, first, second, scale):
    """Add scaled absolute differences to a total."""
    for x in range(len(total)):
        total[x] += scale * abs(first[x] - second[x])


@inner
@no_type_check
def _sample_weights(depth, sample_depth, contrasts, sharpness, max_ratio, weight, weighted_offset):
    """Write each sample's weight, and the weight times the sample's relative offset of inverse depth."""
    for x in range(len(weight)):
        offset = min(depth[x] / sample_depth[x] - _ONE, max_ratio)
        scaled = offset * sharpness
        scaled = _ONE + scaled * scaled
        sample_weight = _ONE / (scaled * scaled * (_ONE + contrasts[x] * contrasts[x]))
        weight[x] = sample_weight
        weighted_offset[x] = sample_weight * offset
