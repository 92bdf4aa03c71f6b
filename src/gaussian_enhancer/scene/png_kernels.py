"""Compiled filter of PNG's rows.

Axes: h height, n bytes of a row.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.splat.compiled import inner, kernel

_PAETH = np.uint8(4)


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
