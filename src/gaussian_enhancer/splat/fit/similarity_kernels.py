"""Compiled SSIM + L1: one pass over rows for the value and the partial derivatives, one for the gradient.

Axes: c channels, h height, w width. Every row is an independent task, so that threads share no data. The filter first
runs down the columns into a row buffer and then along that row, which keeps both passes in the first-level cache.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from gaussian_enhancer.compiled import inner, kernel
from gaussian_enhancer.ssim import C1, C2, RADIUS, SIGMA


def gaussian_window() -> np.ndarray:
    """The window's eleven weights, which sum to one."""
    offsets = np.arange(-RADIUS, RADIUS + 1, dtype=np.float64)
    weights = np.exp(-(offsets**2) / (2.0 * SIGMA**2))
    return (weights / weights.sum()).astype(np.float32)


@inner
@no_type_check
def _along_row(padded, window, out, width):
    """Filter one zero-padded row; the window's symmetry halves the multiplications."""
    w0, w1, w2, w3, w4, w5 = window[5], window[6], window[7], window[8], window[9], window[10]
    for x in range(width):
        out[x] = (
            w0 * padded[x + 5]
            + w1 * (padded[x + 4] + padded[x + 6])
            + w2 * (padded[x + 3] + padded[x + 7])
            + w3 * (padded[x + 2] + padded[x + 8])
            + w4 * (padded[x + 1] + padded[x + 9])
            + w5 * (padded[x] + padded[x + 10])
        )


@kernel
@no_type_check
def photo_statistics(photo, window, mean, square):
    """Filtered photo and filtered squared photo; constant over a fit, so computed once."""
    channels, height, width = photo.shape
    for task in prange(channels * height):
        c, y = task // height, task % height
        row_mean = np.zeros(width + 2 * RADIUS, np.float32)
        row_square = np.zeros(width + 2 * RADIUS, np.float32)
        for row in range(max(0, y - RADIUS), min(height, y + RADIUS + 1)):
            weight = window[row - y + RADIUS]
            for x in range(width):
                value = photo[c, row, x]
                row_mean[x + RADIUS] += weight * value
                row_square[x + RADIUS] += weight * value * value
        _along_row(row_mean, window, mean[c, y], width)
        _along_row(row_square, window, square[c, y], width)


@kernel
@no_type_check
def similarity_forward(image, photo, mean, square, window, partial, ssim, absolute):
    """Sums of SSIM and of absolute differences per row, and SSIM's partial derivatives by its three filtered inputs.

    With a = 2 m_x m_y + C1, b = 2 s_xy + C2, p = m_x^2 + m_y^2 + C1, q = s_xx + s_yy + C2 and SSIM = a b / (p q):
    d/ds_xx = -SSIM / q, d/ds_xy = 2 a / (p q), and by m_x also through s_xx = E[x^2] - m_x^2, s_xy = E[x y] - m_x m_y.
    """
    channels, height, width = image.shape
    for task in prange(channels * height):
        c, y = task // height, task % height
        buffers = np.zeros((3, width + 2 * RADIUS), np.float32)
        filtered = np.empty((3, width), np.float32)
        for row in range(max(0, y - RADIUS), min(height, y + RADIUS + 1)):
            weight = window[row - y + RADIUS]
            for x in range(width):
                value = image[c, row, x]
                weighted = weight * value
                buffers[0, x + RADIUS] += weighted
                buffers[1, x + RADIUS] += weighted * value
                buffers[2, x + RADIUS] += weighted * photo[c, row, x]
        for k in range(3):
            _along_row(buffers[k], window, filtered[k], width)
        total = np.float32(0.0)
        distance = np.float32(0.0)
        for x in range(width):
            mx, my = filtered[0, x], mean[c, y, x]
            sxx = filtered[1, x] - mx * mx
            sxy = filtered[2, x] - mx * my
            syy = square[c, y, x] - my * my
            a = np.float32(2.0) * mx * my + np.float32(C1)
            b = np.float32(2.0) * sxy + np.float32(C2)
            p = np.float32(1.0) / (mx * mx + my * my + np.float32(C1))
            q = np.float32(1.0) / (sxx + syy + np.float32(C2))
            value = a * b * p * q
            by_xx = -value * q
            by_xy = np.float32(2.0) * a * p * q
            by_mean = np.float32(2.0) * (my * b * p * q - mx * value * p)
            partial[0, c, y, x] = by_mean - np.float32(2.0) * mx * by_xx - my * by_xy
            partial[1, c, y, x] = by_xx
            partial[2, c, y, x] = by_xy
            total += value
            distance += abs(image[c, y, x] - photo[c, y, x])
        ssim[task] = total
        absolute[task] = distance


@kernel
@no_type_check
def similarity_backward(image, photo, partial, window, by_ssim, by_absolute, gradient):
    """Gradient with respect to the image; a symmetric zero-padded filter is its own adjoint."""
    channels, height, width = image.shape
    for task in prange(channels * height):
        c, y = task // height, task % height
        buffers = np.zeros((3, width + 2 * RADIUS), np.float32)
        filtered = np.empty((3, width), np.float32)
        for row in range(max(0, y - RADIUS), min(height, y + RADIUS + 1)):
            weight = window[row - y + RADIUS]
            for x in range(width):
                buffers[0, x + RADIUS] += weight * partial[0, c, row, x]
                buffers[1, x + RADIUS] += weight * partial[1, c, row, x]
                buffers[2, x + RADIUS] += weight * partial[2, c, row, x]
        for k in range(3):
            _along_row(buffers[k], window, filtered[k], width)
        for x in range(width):
            value, target = image[c, y, x], photo[c, y, x]
            slope = filtered[0, x] + np.float32(2.0) * value * filtered[1, x] + target * filtered[2, x]
            gradient[c, y, x] = by_ssim * slope + by_absolute * np.sign(value - target)
