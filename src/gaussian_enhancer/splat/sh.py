"""View-dependent colour from real spherical harmonics, forward and backward, on the CPU.

Axes: n Gaussians, k coefficients (1, 4, 9 or 16: degrees 0 to 3).

    colour = max(0, sum_k basis_k(d) sh_k + 1/2),   d = (mean - camera centre) / |mean - camera centre|

Order, sign and constants are those of 3DGS (Kerbl et al. 2023), after Sloan, Efficient Spherical Harmonic Evaluation.
"""

import math

import numpy as np
from jaxtyping import Bool, Float32, Float64
from numba import get_num_threads, prange

from gaussian_enhancer.compiled import inner, kernel, kernel_lock

_ZERO = np.float32(0.0)
_Y0 = 0.28209479177387814
_Y1 = 0.4886025119029199
_Y2A, _Y2B, _Y2C = 1.0925484305920792, 0.31539156525252005, 0.5462742152960396
_Y3A, _Y3B, _Y3C = 0.5900435899266435, 2.890611442640554, 0.4570457994644658
_Y3D, _Y3E = 0.3731763325901154, 1.445305721320277


def shade(
    means: Float32[np.ndarray, "n 3"],
    sh: Float32[np.ndarray, "n k 3"],
    centre: Float64[np.ndarray, " 3"],
    visible: Bool[np.ndarray, " n"],
) -> Float32[np.ndarray, "n 3"]:
    """Colour of each selected Gaussian as seen by the camera; 0 for the others.

    Args:
        means: Gaussian centres in the world.
        sh: coefficients.
        centre: the camera's position in the world.
        visible: mask of the Gaussians to shade.
    """
    with kernel_lock:
        return _shade(means, sh, centre, visible, get_num_threads())


def shade_backward(
    means: Float32[np.ndarray, "n 3"],
    sh: Float32[np.ndarray, "n k 3"],
    centre: Float64[np.ndarray, " 3"],
    visible: Bool[np.ndarray, " n"],
    colours: Float32[np.ndarray, "n 3"],
    colour_gradient: Float32[np.ndarray, "n c"],
    mean_gradient: Float32[np.ndarray, "n 3"],
) -> Float32[np.ndarray, "n k 3"]:
    """Return the gradient of ``sh`` and add that of the means (through the direction) to ``mean_gradient``.

    Args:
        means: as in `shade`.
        sh: as in `shade`.
        centre: as in `shade`.
        visible: as in `shade`.
        colours: result of `shade`; a channel that was clamped to 0 gets no gradient.
        colour_gradient: gradient of the loss with respect to ``colours``, in the first three columns.
        mean_gradient: gradient with respect to the means, changed in place.
    """
    with kernel_lock:
        return _shade_backward(means, sh, centre, visible, colours, colour_gradient, mean_gradient, get_num_threads())


@inner
def basis(count, x, y, z, out):  # type: ignore[no-untyped-def]
    """Write the first ``count`` basis functions at the unit direction (x, y, z) to ``out``."""
    out[0] = _Y0
    if count > 1:
        out[1] = -_Y1 * y
        out[2] = _Y1 * z
        out[3] = -_Y1 * x
    if count > 4:
        out[4] = _Y2A * x * y
        out[5] = -_Y2A * y * z
        out[6] = _Y2B * (2.0 * z * z - x * x - y * y)
        out[7] = -_Y2A * x * z
        out[8] = _Y2C * (x * x - y * y)
    if count > 9:
        out[9] = -_Y3A * y * (3.0 * x * x - y * y)
        out[10] = _Y3B * x * y * z
        out[11] = -_Y3C * y * (4.0 * z * z - x * x - y * y)
        out[12] = _Y3D * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y)
        out[13] = -_Y3C * x * (4.0 * z * z - x * x - y * y)
        out[14] = _Y3E * z * (x * x - y * y)
        out[15] = -_Y3A * x * (x * x - 3.0 * y * y)


@inner
def basis_gradient(count, x, y, z, f):  # type: ignore[no-untyped-def]
    """Gradient of sum_k f_k basis_k with respect to x, y and z, treated as independent variables."""
    gx = gy = gz = 0.0
    if count > 1:
        gx -= _Y1 * f[3]
        gy -= _Y1 * f[1]
        gz += _Y1 * f[2]
    if count > 4:
        gx += _Y2A * y * f[4] - 2.0 * _Y2B * x * f[6] - _Y2A * z * f[7] + 2.0 * _Y2C * x * f[8]
        gy += _Y2A * x * f[4] - _Y2A * z * f[5] - 2.0 * _Y2B * y * f[6] - 2.0 * _Y2C * y * f[8]
        gz += -_Y2A * y * f[5] + 4.0 * _Y2B * z * f[6] - _Y2A * x * f[7]
    if count > 9:
        xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
        gx += -6.0 * _Y3A * xy * f[9] + _Y3B * yz * f[10] + 2.0 * _Y3C * xy * f[11] - 6.0 * _Y3D * xz * f[12]
        gx += -_Y3C * (4.0 * zz - 3.0 * xx - yy) * f[13] + 2.0 * _Y3E * xz * f[14]
        gx -= 3.0 * _Y3A * (xx - yy) * f[15]
        gy += -3.0 * _Y3A * (xx - yy) * f[9] + _Y3B * xz * f[10] - _Y3C * (4.0 * zz - xx - 3.0 * yy) * f[11]
        gy += -6.0 * _Y3D * yz * f[12] + 2.0 * _Y3C * xy * f[13] - 2.0 * _Y3E * yz * f[14]
        gy += 6.0 * _Y3A * xy * f[15]
        gz += _Y3B * xy * f[10] - 8.0 * _Y3C * yz * f[11] + 3.0 * _Y3D * (2.0 * zz - xx - yy) * f[12]
        gz += -8.0 * _Y3C * xz * f[13] + _Y3E * (xx - yy) * f[14]
    return gx, gy, gz


@kernel
def _shade(means, sh, centre, visible, threads):  # type: ignore[no-untyped-def]
    n, count = sh.shape[0], sh.shape[1]
    colours = np.zeros((n, 3), np.float32)
    for thread in prange(threads):
        weights = np.empty(16)
        for g in range(thread * n // threads, (thread + 1) * n // threads):
            if visible[g]:
                x, y, z = means[g, 0] - centre[0], means[g, 1] - centre[1], means[g, 2] - centre[2]
                scale = 1.0 / math.sqrt(max(x * x + y * y + z * z, 1e-300))
                basis(count, x * scale, y * scale, z * scale, weights)
                red = green = blue = 0.5
                for k in range(count):
                    red += weights[k] * sh[g, k, 0]
                    green += weights[k] * sh[g, k, 1]
                    blue += weights[k] * sh[g, k, 2]
                colours[g, 0], colours[g, 1], colours[g, 2] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
    return colours


@kernel
def _shade_backward(means, sh, centre, visible, colours, colour_gradient, mean_gradient, threads):  # type: ignore[no-untyped-def]
    n, count = sh.shape[0], sh.shape[1]
    sh_gradient = np.empty((n, count, 3), np.float32)
    for thread in prange(threads):
        weights, by_basis = np.empty(16), np.empty(16)
        for g in range(thread * n // threads, (thread + 1) * n // threads):
            if visible[g]:
                x, y, z = means[g, 0] - centre[0], means[g, 1] - centre[1], means[g, 2] - centre[2]
                scale = 1.0 / math.sqrt(max(x * x + y * y + z * z, 1e-300))
                x, y, z = x * scale, y * scale, z * scale
                basis(count, x, y, z, weights)
                red = colour_gradient[g, 0] if colours[g, 0] > 0.0 else _ZERO
                green = colour_gradient[g, 1] if colours[g, 1] > 0.0 else _ZERO
                blue = colour_gradient[g, 2] if colours[g, 2] > 0.0 else _ZERO
                for k in range(count):
                    weight = np.float32(weights[k])
                    sh_gradient[g, k, 0], sh_gradient[g, k, 1] = weight * red, weight * green
                    sh_gradient[g, k, 2] = weight * blue
                    by_basis[k] = sh[g, k, 0] * red + sh[g, k, 1] * green + sh[g, k, 2] * blue
                gx, gy, gz = basis_gradient(count, x, y, z, by_basis)
                radial = gx * x + gy * y + gz * z
                mean_gradient[g, 0] += (gx - radial * x) * scale
                mean_gradient[g, 1] += (gy - radial * y) * scale
                mean_gradient[g, 2] += (gz - radial * z) * scale
            else:
                sh_gradient[g] = _ZERO
    return sh_gradient
