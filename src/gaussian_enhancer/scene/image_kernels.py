"""Compiled kernels for writing images: quantisation to 8 bits, and PNG's row filter.

Axes: c channels, h height, w width, n bytes of a row.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.compiled import inner, kernel

_F = np.float32
_ZERO, _ONE, _LEVELS = _F(0), _F(1), _F(255)
_PAETH = np.uint8(4)


@kernel
@no_type_check
def quantise(image, result):
    """Write planes (c, h, w) of colours as 8-bit pixels (h, w, c); values outside [0, 1] are clamped."""
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
    """Write for each row the number of the Paeth filter, then each byte minus its prediction.

    Args:
        image: rows of pixel bytes, (h, n).
        channels: bytes per pixel.
        result: output, (h, 1 + n).
    """
    height, length = image.shape
    for y in prange(height):
        above = np.zeros(length, np.uint8) if y == 0 else image[y - 1]
        result[y, 0] = _PAETH
        _filter_row(image[y], above, channels, result[y, 1:])


@inner
@no_type_check
def _filter_row(row, above, channels, result):
    for x in range(channels):  # without a left neighbour, the prediction is the byte above
        result[x] = row[x] - above[x]
    for x in range(channels, len(row)):
        left, up, up_left = np.int16(row[x - channels]), np.int16(above[x]), np.int16(above[x - channels])
        to_left, to_up, to_up_left = abs(up - up_left), abs(left - up_left), abs(left + up - up_left - up_left)
        if to_left <= to_up and to_left <= to_up_left:
            prediction = left
        else:
            prediction = up if to_up <= to_up_left else up_left
        result[x] = np.uint8(np.int16(row[x]) - prediction)
