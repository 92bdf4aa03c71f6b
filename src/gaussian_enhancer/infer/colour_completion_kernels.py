"""Compiled kernel of `colour_completion`: evaluates the model at every pixel in one pass over memory.

Axes: h height, w width, i j cells of the coarse grid; images are (channels, height, width) float32.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.compiled import inner, kernel

_F = np.float32
_ZERO, _ONE, _HALF = _F(0), _F(1), _F(0.5)


@kernel
@no_type_check
def complete(enhanced, render, opaque, model, result):
    """Write enhanced + unseen x opaque x (matrix render + offset), with the model interpolated between cell centres.

    model (13, i, j) holds the matrix's nine values by rows, the three offsets, and ``unseen``: the degree, in [0, 1],
    to which no reference shows a cell. Interpolation is linear.
    """
    _, height, width = render.shape
    planes, rows, columns = model.shape
    left, right, column_fractions = cells_along(width, width, columns)
    for y in prange(height):
        above, below, row_fraction = cells_around(y, height, rows)
        row_model = np.empty((planes, columns), np.float32)
        for k in range(planes):
            for j in range(columns):
                row_model[k, j] = model[k, above, j] + row_fraction * (model[k, below, j] - model[k, above, j])
        pixel_model = np.empty((planes, width), np.float32)
        for k in range(planes):
            interpolate_cells(row_model[k], left, right, column_fractions, pixel_model[k])
        for c in range(3):
            for x in range(width):
                change = pixel_model[9 + c, x]
                for k in range(3):
                    change += pixel_model[3 * c + k, x] * render[k, y, x]
                result[c, y, x] = enhanced[c, y, x] + pixel_model[12, x] * opaque[y, x] * change


@inner
@no_type_check
def cells_around(position, count, cells):
    """The two cells whose centres enclose a pixel's centre, and the pixel's fraction of the way between them.

    Beyond the outermost centres, the value of the outermost cell holds.
    """
    cell_position = max((_F(position) + _HALF) * _F(cells) / _F(count) - _HALF, _ZERO)
    first = min(int(cell_position), cells - 1)
    return first, min(first + 1, cells - 1), min(cell_position - _F(first), _ONE)


@inner
@no_type_check
def cells_along(pixels, count, cells):
    """`cells_around` of every pixel of a row: indices of the first and the second cell, and fractions."""
    first, second = np.empty(pixels, np.int32), np.empty(pixels, np.int32)
    fractions = np.empty(pixels, np.float32)
    for x in range(pixels):
        first[x], second[x], fractions[x] = cells_around(x, count, cells)
    return first, second, fractions


@inner
@no_type_check
def interpolate_cells(values, first, second, share, result):
    """Write values interpolated linearly between cells."""
    for x in range(len(result)):
        result[x] = values[first[x]] + share[x] * (values[second[x]] - values[first[x]])
