"""Compiled colour clamping: the same as `colour_clamping`, by rows so that loops vectorise.

Axes: r references, h height, w width; images are (channels, height, width) float32.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.compiled import inner, kernel

_F = np.float32
_ZERO, _ONE, _INFINITE = _F(0), _F(1), _F(np.inf)


@kernel
@no_type_check
def clamp(image, render, photos, visibility, reach, clamp_unseen, result):
    """Write the image clamped to minimum and maximum of render and visible photos (r, 3, h, w) around each pixel.

    Pixels at which no photo is visible are clamped to [0, 1] unless ``clamp_unseen`` is set.
    """
    channels, height, width = image.shape
    for y in prange(height):
        column_low, column_high = np.empty(width + 2 * reach, np.float32), np.empty(width + 2 * reach, np.float32)
        inner_low, inner_high = column_low[reach : reach + width], column_high[reach : reach + width]
        low, high = np.empty(width, np.float32), np.empty(width, np.float32)
        most_visible = np.zeros(width, np.float32)
        for r in range(len(photos)):
            for x in range(width):
                most_visible[x] = max(most_visible[x], visibility[r, 0, y, x])
        for c in range(channels):
            column_low[:], column_high[:] = _INFINITE, -_INFINITE
            for j in range(max(0, y - reach), min(height, y + reach + 1)):
                _widen_limits(render[c, j], render[c, j], inner_low, inner_high)
                for r in range(len(photos)):
                    _widen_visible_limits(photos[r, c, j], visibility[r, 0, j], inner_low, inner_high)
            low[:], high[:] = _INFINITE, -_INFINITE
            for i in range(2 * reach + 1):
                _widen_limits(column_low[i : i + width], column_high[i : i + width], low, high)
            for x in range(width):
                limited = clamp_unseen or most_visible[x] > _ZERO
                lower, upper = low[x] if limited else _ZERO, high[x] if limited else _ONE
                result[c, y, x] = min(max(image[c, y, x], lower), upper)


@inner
@no_type_check
def _widen_limits(other_low, other_high, low, high):
    """Extend limits to include other limits."""
    for x in range(len(low)):
        low[x], high[x] = min(low[x], other_low[x]), max(high[x], other_high[x])


@inner
@no_type_check
def _widen_visible_limits(values, visibility, low, high):
    """Extend limits to include values where these are visible."""
    for x in range(len(low)):
        visible = visibility[x] > _ZERO
        low[x] = min(low[x], values[x] if visible else _INFINITE)
        high[x] = max(high[x], values[x] if visible else -_INFINITE)
