"""Compiled colour clamping: the same as `colour_clamping`, by rows so that loops vectorise.

Axes: r references, h height, w width; images are (channels, height, width) float32.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.splat.compiled import inner, kernel

_F = np.float32
_ZERO, _INFINITE = _F(0), _F(np.inf)


@kernel
@no_type_check
def clamp(image, render, photos, visibility, reach, result):
    """Write the image clamped to minimum and maximum of render and visible photos (r, 3, h, w) around each pixel."""
    channels, height, width = image.shape
    for y in prange(height):
        low, high = np.empty(width + 2 * reach, np.float32), np.empty(width + 2 * reach, np.float32)
        least, greatest = np.empty(width, np.float32), np.empty(width, np.float32)
        for c in range(channels):
            low[:], high[:] = _INFINITE, -_INFINITE
            for j in range(max(0, y - reach), min(height, y + reach + 1)):
                _widen_limits(render[c, j], render[c, j], low[reach : reach + width], high[reach : reach + width])
                for r in range(len(photos)):
                    inside = low[reach : reach + width], high[reach : reach + width]
                    _widen_visible_limits(photos[r, c, j], visibility[r, 0, j], inside[0], inside[1])
            least[:], greatest[:] = _INFINITE, -_INFINITE
            for i in range(2 * reach + 1):
                _widen_limits(low[i : i + width], high[i : i + width], least, greatest)
            for x in range(width):
                result[c, y, x] = min(max(image[c, y, x], least[x]), greatest[x])


@inner
@no_type_check
def _widen_limits(low, high, least, greatest):
    """Extend limits to include other limits."""
    for x in range(len(least)):
        least[x], greatest[x] = min(least[x], low[x]), max(greatest[x], high[x])


@inner
@no_type_check
def _widen_visible_limits(values, visibility, least, greatest):
    """Extend limits to include values where these are visible."""
    for x in range(len(least)):
        visible = visibility[x] > _ZERO
        least[x] = min(least[x], values[x] if visible else _INFINITE)
        greatest[x] = max(greatest[x], values[x] if visible else -_INFINITE)
