"""Compiled passes over the images of super-resolution: bicubic upsampling, and merging of references.

Images are planes of float32; features are bfloat16 in channels-last memory.

Axes: n planes, r references, h height, w width, i = h / 2, j = w / 2.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.compiled import add_scaled, inner, kernel
from gaussian_enhancer.network.bfloat16_kernels import double_row, to_bfloat16

_F = np.float32
_ZERO, _ONE, _HALF, _LEAST = _F(0), _F(1), _F(0.5), _F(1e-6)
TAPS, BORDER = 4, 3
"""Pixels that a cubic kernel reads along an axis, and pixels by which a row is extended on both sides."""


@kernel
@no_type_check
def upsample(image, shares, starts, result):
    """Write planes (n, h, w) upsampled by 2 or 4, with cubic interpolation along both axes.

    Args:
        image: planes; outside them the border's values are used.
        shares: for each phase of a fine pixel within a coarse one, the weights of four coarse pixels.
        starts: for each phase, the first of these pixels, relative to the coarse pixel that contains the fine one.
        result: output.
    """
    planes, height, width = image.shape
    scale = len(starts)
    for line in prange(planes * height * scale):
        n, y = line // (height * scale), line % (height * scale)
        i, phase = y // scale, y % scale
        row = np.zeros(width + 2 * BORDER, np.float32)
        for k in range(TAPS):
            source_row = min(max(i + starts[phase] + k, 0), height - 1)
            add_scaled(row[BORDER : BORDER + width], image[n, source_row], shares[phase, k])
        row[:BORDER], row[BORDER + width :] = row[BORDER], row[BORDER + width - 1]
        fine = np.empty((scale, width), np.float32)
        for q in range(scale):
            first = BORDER + starts[q]
            _weigh_neighbours(row, first, shares[q], fine[q])
        if scale == 2:
            _interleave_2(fine[0], fine[1], result[n, y])
        else:
            _interleave_4(fine[0], fine[1], fine[2], fine[3], result[n, y])


@inner
@no_type_check
def _weigh_neighbours(row, first, shares, result):
    """Write the weighted sum of four neighbours."""
    a, b, c, d = shares[0], shares[1], shares[2], shares[3]
    p0, p1, p2, p3 = row[first:], row[first + 1 :], row[first + 2 :], row[first + 3 :]
    for x in range(len(result)):
        result[x] = a * p0[x] + b * p1[x] + c * p2[x] + d * p3[x]


@inner
@no_type_check
def _interleave_2(first, second, result):
    for x in range(len(first)):
        result[2 * x], result[2 * x + 1] = first[x], second[x]


@inner
@no_type_check
def _interleave_4(first, second, third, fourth, result):
    for x in range(len(first)):
        result[4 * x], result[4 * x + 1] = first[x], second[x]
        result[4 * x + 2], result[4 * x + 3] = third[x], fourth[x]


@kernel
@no_type_check
def merge(photos, halved, visibility, trust, mean, mask, soft, trust_sum):
    """Write the results of `ssif_sr.merge_torch`: mean of the references, its mask, its soft part, sum of trust.

    Args:
        photos: references, (r, 3, h, w).
        halved: the same at half the resolution, (r, 3, i, j).
        visibility: visibility of the references, (r, i, j).
        trust: trust of the references, (r, i, j).
        mean: output, (3, h, w).
        mask: output, (h, w): 1 where a reference is trusted.
        soft: output, (3, h, w): content of the mean at half the resolution.
        trust_sum: output, (i, j): the sum of trust.
    """
    count, _, height, width = photos.shape
    weighted = np.empty((3, height // 2, width // 2), np.float32)
    for i in prange(height // 2):
        trust_sum[i] = _ZERO
        for r in range(count):
            add_scaled(trust_sum[i], trust[r, i], _ONE)
        for c in range(3):
            weighted[c, i] = _ZERO
            for r in range(count):
                _add_product(weighted[c, i], trust[r, i], halved[r, c, i])
    for y in prange(height):
        weight, total = np.empty((count, width), np.float32), np.zeros(width, np.float32)
        for r in range(count):
            double_row(trust[r], y, weight[r])
            _zero_invisible(weight[r], visibility[r, y // 2])
            add_scaled(total, weight[r], _ONE)
        for x in range(width):
            mask[y, x] = _ONE if total[x] > _ZERO else _ZERO
        trust_row = np.empty(width, np.float32)
        double_row(trust_sum, y, trust_row)
        for c in range(3):
            mean[c, y] = _ZERO
            for r in range(count):
                _add_product(mean[c, y], weight[r], photos[r, c, y])
            _divide(mean[c, y], total)
            double_row(weighted[c], y, soft[c, y])
            _divide(soft[c, y], trust_row)


@inner
@no_type_check
def _zero_invisible(weight, visibility):
    """Set the weights of invisible pixels to 0; visibility is at half the resolution."""
    for j in range(len(visibility)):
        if visibility[j] <= _ZERO:
            weight[2 * j] = weight[2 * j + 1] = _ZERO


@inner
@no_type_check
def _add_product(total, factor, values):
    for x in range(len(total)):
        total[x] += factor[x] * values[x]


@inner
@no_type_check
def _divide(values, total):
    for x in range(len(values)):
        values[x] /= max(total[x], _LEAST)


@kernel
@no_type_check
def pack_merged(base, photo, mask, trust, result):
    """Write (photo - base) x mask, then base - 1/2, pixel-unshuffled by 2, then trust: (i, j, 25) bfloat16."""
    _, height, width = base.shape
    for i in prange(height // 2):
        for j in range(width // 2):
            for c in range(3):
                for a in range(2):
                    for b in range(2):
                        y, x = 2 * i + a, 2 * j + b
                        result[i, j, 4 * c + 2 * a + b] = to_bfloat16((photo[c, y, x] - base[c, y, x]) * mask[y, x])
                        result[i, j, 12 + 4 * c + 2 * a + b] = to_bfloat16(base[c, y, x] - _HALF)
            result[i, j, 24] = to_bfloat16(trust[i, j])
