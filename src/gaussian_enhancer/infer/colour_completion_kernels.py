"""Compiled colour completion: the same as `colour_completion` at every pixel, in one pass over memory.

Axes: h height, w width, i j cells of the coarse grid; images are (channels, height, width) float32.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.splat.compiled import inner, kernel

_F = np.float32
_ZERO, _ONE, _HALF = _F(0), _F(1), _F(0.5)


@kernel
@no_type_check
def complete(enhanced, render, opaque, model, result):
    """Write enhanced + unseen x opaque x (matrix render + offset), the model being linear between its cells' centres.

    model (13, i, j) holds the matrix's nine values by rows, the three offsets, and how far a cell is unseen.
    """
    _, height, width = render.shape
    planes, rows, columns = model.shape
    left, right, across = cells_along(width, width, columns)
    for y in prange(height):
        above, below, down = cells_around(y, height, rows)
        row = np.empty((planes, columns), np.float32)
        for k in range(planes):
            for j in range(columns):
                row[k, j] = model[k, above, j] + down * (model[k, below, j] - model[k, above, j])
        fine = np.empty((planes, width), np.float32)
        for k in range(planes):
            read_between(row[k], left, right, across, fine[k])
        for c in range(3):
            for x in range(width):
                change = fine[9 + c, x]
                for k in range(3):
                    change += fine[3 * c + k, x] * render[k, y, x]
                result[c, y, x] = enhanced[c, y, x] + fine[12, x] * opaque[y, x] * change


@inner
@no_type_check
def cells_around(position, count, cells):
    """The two cells whose centres enclose a pixel's, and the fraction between them; the outermost at the borders."""
    place = max((_F(position) + _HALF) * _F(cells) / _F(count) - _HALF, _ZERO)
    first = min(int(place), cells - 1)
    return first, min(first + 1, cells - 1), min(place - _F(first), _ONE)


@inner
@no_type_check
def cells_along(pixels, count, cells):
    """`cells_around` of every pixel of a row: both cells' indices, and how far along."""
    first, second = np.empty(pixels, np.int32), np.empty(pixels, np.int32)
    share = np.empty(pixels, np.float32)
    for x in range(pixels):
        first[x], second[x], share[x] = cells_around(x, count, cells)
    return first, second, share


@inner
@no_type_check
def read_between(values, first, second, share, result):
    """Write values between cells, linearly."""
    for x in range(len(result)):
        result[x] = values[first[x]] + share[x] * (values[second[x]] - values[first[x]])
