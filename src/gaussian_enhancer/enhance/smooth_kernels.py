"""Compiled fit of planes to depth: what `smooth.fitted` does, a row at a time so that pixels fill a vector.

Axes: h height, w width; images are (channels, height, width) float32.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.splat.compiled import kernel

_F = np.float32
_ONE = _F(1)


@kernel
@no_type_check
def fit_planes(depth, render, step, reach, sharpness, contrast, ridge, furthest, result):
    """Write how far each pixel's plane lies beyond it; depth and render have a margin of ``reach`` samples."""
    height, width = result.shape
    margin = reach * step
    for y in prange(height):
        sums = np.zeros((9, width), np.float32)
        one, sx, sy, sxx, sxy, syy, sp, sxp, syp = (
            sums[0], sums[1], sums[2], sums[3], sums[4], sums[5], sums[6], sums[7], sums[8],
        )  # fmt: skip
        row = y + margin
        here = depth[row, margin : margin + width]
        red, green, blue = (
            render[0, row, margin : margin + width],
            render[1, row, margin : margin + width],
            render[2, row, margin : margin + width],
        )
        for j in range(-reach, reach + 1):
            dy, other = _F(j), row + j * step
            for i in range(-reach, reach + 1):
                dx, left = _F(i), margin + i * step
                for x in range(width):
                    beyond = min(here[x] / depth[other, left + x] - _ONE, furthest)
                    far = beyond * sharpness
                    far = _ONE + far * far
                    differs = (
                        abs(render[0, other, left + x] - red[x])
                        + abs(render[1, other, left + x] - green[x])
                        + abs(render[2, other, left + x] - blue[x])
                    ) * contrast
                    weight = _ONE / (far * far * (_ONE + differs * differs))
                    wx, wy, wp = weight * dx, weight * dy, weight * beyond
                    one[x] += weight
                    sx[x] += wx
                    sy[x] += wy
                    sxx[x] += wx * dx
                    sxy[x] += wx * dy
                    syy[x] += wy * dy
                    sp[x] += wp
                    sxp[x] += wp * dx
                    syp[x] += wp * dy
        for x in range(width):
            xx, yy, xy = sxx[x] + ridge, syy[x] + ridge, sxy[x]
            area = xx * yy - xy * xy
            across, down = (sx[x] * yy - sy[x] * xy) / area, (sy[x] * xx - sx[x] * xy) / area
            rest = one[x] - across * sx[x] - down * sy[x]
            result[y, x] = (sp[x] - across * sxp[x] - down * syp[x]) / rest
