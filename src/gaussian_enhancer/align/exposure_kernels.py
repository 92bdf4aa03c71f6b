"""Compiled colour matching of references: the CPU version of `exposure.fit_colour`.

Axes: c channels, h height, w width, n blocks.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.compiled import exact_inner, exact_kernel, inner, kernel

_F = np.float32
_ZERO, _FAINT = _F(0), _F(1e-6)


@kernel
@no_type_check
def block_means(source, target, weight, step, mass, means):
    """Write weighted mean colours over blocks of pixels, and the mean weight of each block.

    Args:
        source: colours, (c, h, w).
        target: colours, (c, h, w).
        weight: weights, (h, w).
        step: side of a block in pixels; incomplete blocks at the right and at the bottom are ignored.
        mass: output, (n), with blocks row by row.
        means: output, (2, c, n): source, then target.
    """
    channels, height, width = source.shape
    rows, columns = height // step, width // step
    share = _F(1) / _F(step * step)
    for i in prange(rows):
        block, row = slice(i * columns, (i + 1) * columns), np.zeros((2, columns * step), np.float32)
        for y in range(i * step, (i + 1) * step):
            for x in range(columns * step):
                row[0, x] += weight[y, x]
        _add_up(row[0], step, share, mass[block])
        for c in range(channels):
            row[:] = _ZERO
            for y in range(i * step, (i + 1) * step):
                for x in range(columns * step):
                    row[0, x] += source[c, y, x] * weight[y, x]
                    row[1, x] += target[c, y, x] * weight[y, x]
            for k in range(2):
                _add_up(row[k], step, share, means[k, c, block])
                for j in range(columns):
                    means[k, c, i * columns + j] /= max(mass[i * columns + j], _FAINT)


@inner
@no_type_check
def _add_up(row, step, share, result):
    """Write the sum of each group of ``step`` neighbours, times ``share``."""
    for j in range(len(result)):
        total = _ZERO
        for x in range(j * step, (j + 1) * step):
            total += row[x]
        result[j] = share * total


@exact_kernel
@no_type_check
def fit_channels(mass, means, robustness, prior, iterations, result):
    """Write gain and offset of each channel by iteratively reweighted least squares.

    Args:
        mass: weight of each block, (n).
        means: colours of source and target, (2, c, n).
        robustness: see `exposure.fit_colour`.
        prior: see `exposure.fit_colour`.
        iterations: number of reweightings.
        result: output, (c, 2), float64.
    """
    total_mass = 0.0
    for k in range(len(mass)):
        total_mass += mass[k]
    prior_weight = prior * total_mass
    for c in prange(means.shape[1]):
        weights = np.empty(len(mass), np.float64)
        gain, offset = 1.0, 0.0
        for _ in range(iterations):
            _reweight(mass, means[0, c], means[1, c], gain, offset, robustness, weights)
            ss, s, w, st, t = _moments(weights, means[0, c], means[1, c])
            ss, w, st = ss + prior_weight / 4, w + prior_weight, st + prior_weight / 4
            gain = (st * w - t * s) / max(ss * w - s * s, 1e-12)
            gain = min(max(gain, 1 / 3), 3.0)
            offset = (t - gain * s) / w
        result[c, 0], result[c, 1] = gain, offset


@exact_inner
@no_type_check
def _reweight(mass, source, target, gain, offset, robustness, weights):
    """Write each block's mass times its Geman-McClure weight."""
    for k in range(len(mass)):
        residual = (gain * source[k] + offset - target[k]) / robustness
        spread = 1.0 + residual * residual
        weights[k] = mass[k] / (spread * spread)


@exact_inner
@no_type_check
def _moments(weights, source, target):
    """Weighted sums of s s, s, 1, s t and t, in double precision."""
    ss = s = w = st = t = 0.0
    for k in range(len(weights)):
        weight, source_value, target_value = weights[k], np.float64(source[k]), np.float64(target[k])
        ss += weight * source_value * source_value
        s += weight * source_value
        w += weight
        st += weight * source_value * target_value
        t += weight * target_value
    return ss, s, w, st, t
