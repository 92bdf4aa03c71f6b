"""Compiled kernels of `change_confidence`: products of block vectors, and application of shares, in one pass each.

Axes: r references, v vectors of a block, h height, w width, i j blocks.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.compiled import inner, kernel
from gaussian_enhancer.infer.colour_completion_kernels import cells_along, cells_around, interpolate_cells

_F = np.float32
_ZERO, _ONE, _THREE = _F(0), _F(1), _F(3)


@kernel
@no_type_check
def block_products(
    enhanced, render, photos, renders, visibility, has_renders, block, step, means, details, visible_share, change
):
    """Write mean products (v, v, i, j) of each two vectors, for means and for details, visible shares and mean changes.

    Images are (3, h, w), those of references (r, 3, h, w); ``renders`` are read if ``has_renders`` is positive. Every
    ``step``-th row and column of a block is sampled.
    """
    count = len(photos)
    vectors, rows, columns = means.shape[0], means.shape[2], means.shape[3]
    for i in prange(rows):
        values = np.empty((vectors, 3 * (block // step) ** 2), np.float32)
        mean = np.empty((vectors, 3), np.float32)
        for j in range(columns):
            values[:], mean[:] = _ZERO, _ZERO
            sample_count = _gather_block(
                i * block, j * block, enhanced, render, photos, renders, visibility, has_renders, block, step, values
            )
            for r in range(count):
                visible_count = _visible_count(i * block, j * block, visibility[r, 0], block, step)
                visible_share[r, i, j] = visible_count / sample_count
            samples = values.shape[1] // 3
            for v in range(vectors):
                for c in range(3):
                    total = _ZERO
                    for n in range(samples):
                        total += values[v, c * samples + n]
                    mean[v, c] = total / sample_count
            change[:, i, j] = mean[0]
            for v in range(vectors):
                for u in range(v + 1):
                    product_sum = _ZERO
                    for n in range(values.shape[1]):
                        product_sum += values[v, n] * values[u, n]
                    product_of_means = (
                        mean[v, 0] * mean[u, 0] + mean[v, 1] * mean[u, 1] + mean[v, 2] * mean[u, 2]
                    ) / _THREE
                    means[v, u, i, j] = means[u, v, i, j] = product_of_means
                    details[v, u, i, j] = details[u, v, i, j] = product_sum / (_THREE * sample_count) - product_of_means


@inner
@no_type_check
def _gather_block(top, left, enhanced, render, photos, renders, visibility, has_renders, block, step, values):
    """Write a block's vectors, the samples of a channel contiguously; return the number of samples inside the image."""
    count, samples, sample_count = len(photos), values.shape[1] // 3, _ZERO
    for y in range(top, min(top + block, render.shape[1]), step):
        for x in range(left, min(left + block, render.shape[2]), step):
            sample = (y - top) // step * (block // step) + (x - left) // step
            sample_count += _ONE
            for c in range(3):
                n, render_value = c * samples + sample, render[c, y, x]
                change = enhanced[c, y, x] - render_value
                values[0, n], values[1, n] = change, render_value
                for r in range(count):
                    if visibility[r, 0, y, x] > _ZERO:
                        photo = photos[r, c, y, x]
                        values[2 + r, n] = change
                        values[2 + count + r, n] = photo - render_value
                        reference_render = renders[r, c, y, x] if has_renders > _ZERO else render_value
                        values[2 + 2 * count + r, n] = photo - reference_render
    return sample_count


@inner
@no_type_check
def _visible_count(top, left, visibility, block, step):
    """Number of a block's samples that are visible."""
    total = _ZERO
    for y in range(top, min(top + block, visibility.shape[0]), step):
        for x in range(left, min(left + block, visibility.shape[1]), step):
            total += _ONE if visibility[y, x] > _ZERO else _ZERO
    return total


@kernel
@no_type_check
def apply_shares(enhanced, render, shares, block, result):
    """Write the render plus shares of the change: one share of its block means, one of the remaining details.

    Images are (3, h, w), shares (2, i, j). Shares and means are interpolated linearly between block centres.
    """
    _, height, width = render.shape
    _, rows, columns = shares.shape
    planes = np.empty((5, rows, columns), np.float32)
    for i in prange(rows):
        bottom = min((i + 1) * block, height)
        for j in range(columns):
            right_end = min((j + 1) * block, width)
            planes[0, i, j], planes[1, i, j] = shares[0, i, j], shares[1, i, j]
            for c in range(3):
                total = _ZERO
                for y in range(i * block, bottom):
                    for x in range(j * block, right_end):
                        total += enhanced[c, y, x] - render[c, y, x]
                planes[2 + c, i, j] = total / _F((bottom - i * block) * (right_end - j * block))
    left, right, column_fractions = cells_along(width, columns * block, columns)
    for y in prange(height):
        above, below, row_fraction = cells_around(y, rows * block, rows)
        row_planes = np.empty((5, columns), np.float32)
        for k in range(5):
            for j in range(columns):
                row_planes[k, j] = planes[k, above, j] + row_fraction * (planes[k, below, j] - planes[k, above, j])
        pixel_planes = np.empty((5, width), np.float32)
        for k in range(5):
            interpolate_cells(row_planes[k], left, right, column_fractions, pixel_planes[k])
        for c in range(3):
            _apply_row(
                enhanced[c, y], render[c, y], pixel_planes[0], pixel_planes[1], pixel_planes[2 + c], result[c, y]
            )


@inner
@no_type_check
def _apply_row(enhanced, render, of_mean, of_detail, mean, result):
    for x in range(len(result)):
        detail = enhanced[x] - render[x] - mean[x]
        result[x] = min(max(render[x] + of_mean[x] * mean[x] + of_detail[x] * detail, _ZERO), _ONE)
