"""Compiled steps of writing an image: 8-bit pixels, and the filter of PNG's rows.

Axes: c channels, h height, w width, n bytes of a row.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.splat.compiled import inner, kernel

_F = np.float32
_ZERO, _ONE, _LEVELS = _F(0), _F(1), _F(255)
_PAETH = np.uint8(4)


@kernel
@no_type_check
def quantise(image, result):
    """Write planes (c, h, w) of colours in [0, 1] as 8-bit pixels (h, w, c); what lies outside is clamped."""
    channels, height, _ = image.shape
    for y in prange(height):
        for c in range(channels):
            _quantise_row(image[c, y], result[y], c)


@inner
@no_type_check
def _quantise_row(row, pixels, channel):
    for x in range(len(row)):
        pixels[x, channel] = np.uint8(np.int32(np.rint(min(max(row[x], _ZERO), _ONE) * _LEVELS)))


@kernel
@no_type_check
def filter_rows(image, channels, result):
    """Write the filter's number, then each byte minus the one that Paeth's predictor expects.

    Args:
        image: (h, n).
        channels: bytes of a pixel.
        result: is written, (h, 1 + n).
    """
    height, length = image.shape
    for y in prange(height):
        above = np.zeros(length, np.uint8) if y == 0 else image[y - 1]
        result[y, 0] = _PAETH
        _filter_row(image[y], above, channels, result[y, 1:])


@inner
@no_type_check
def _filter_row(row, above, channels, result):
    for x in range(channels):  # nothing lies to the left, so that the predictor takes what lies above
        result[x] = row[x] - above[x]
    for x in range(channels, len(row)):
        left, up, corner = np.int16(row[x - channels]), np.int16(above[x]), np.int16(above[x - channels])
        to_left, to_up, to_corner = abs(up - corner), abs(left - corner), abs(left + up - corner - corner)
        if to_left <= to_up and to_left <= to_corner:
            expected = left
        else:
            expected = up if to_up <= to_corner else corner
        result[x] = np.uint8(np.int16(row[x]) - expected)
