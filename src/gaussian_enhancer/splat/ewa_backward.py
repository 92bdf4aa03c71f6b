"""Backward of the projection of ellipsoids (3DGS, Mip-Splatting): image gradients to parameter gradients, on the CPU.

Axes: n Gaussians. W is the whitening (cov2d^-1 = W^T W), w = W (pixel - centre) and h = dL/dalpha alpha. The
rasteriser provides sum h, sum h w and H = sum h w w^T, from which

    dL/dcentre = W^T sum h w,    dL/dcov2d = W^T H W / 2

Column k of M (see `splat.ewa`) is m_k = s_k p_k. With y_k = W p_k no large terms cancel, however thin a needle is:

    dL/dlog s_k = s_k^2 y_k^T H y_k,    dL/dangle about axis 3 = (s_1^2 - s_2^2) y_1^T H y_2    (and cyclic)

The angles are of rotations about the Gaussian's axes; the quaternion changes by dq = q (0, dangle) / 2. Mip-Splatting's
2D factor contributes through the rows of M. All computations are in float64.
"""

import math

import numpy as np
from jaxtyping import Bool, Float32, Float64
from numba import prange

from gaussian_enhancer.compiled import inner, kernel, kernel_lock
from gaussian_enhancer.splat.ewa import (
    Shape,
    ShapeGradient,
    View,
    cross,
    dot,
    ellipse_of,
    linear_combination,
    whitening_of,
)

_NATURAL = 2.0 * math.log(2.0)  # the rasteriser's u^2 + v^2 is an exponent of base 2


def project_backward(
    shape: Shape,
    view: View,
    dilation: float,
    mip: bool,
    visible: Bool[np.ndarray, " n"],
    gradients: Float32[np.ndarray, "n 16"],
) -> ShapeGradient:
    """Gradients with respect to the Gaussians' parameters, from the gradients that the rasteriser returns.

    Args:
        shape: as in `project`.
        view: as in `project`.
        dilation: as in `project`.
        mip: as in `project`.
        visible: mask of the Gaussians that some tile lists; the others' gradients are 0.
        gradients: result of `splat.raster.blend_backward`, summed over tiles.
    """
    with kernel_lock:
        return ShapeGradient(*_project_backward(shape, view, dilation, mip, visible, gradients))


def screen_gradients(
    whitening: Float64[np.ndarray, "n 5"], gradients: Float32[np.ndarray, "n 16"]
) -> Float32[np.ndarray, "n 2"]:
    """Gradient with respect to the 2D mean in pixels."""
    a, b, c, d = whitening[:, :4].T
    hu, hv = gradients[:, 5], gradients[:, 6]
    by_mean = np.stack([a * hu + c * hv, b * hu + d * hv], axis=1) * _NATURAL
    return by_mean.astype(np.float32)


@inner
def _filter_rows(weight, m1, m2, normal, covariance, dilation):  # type: ignore[no-untyped-def]
    """Gradient of log sqrt(raw / det), Mip-Splatting's 2D factor, with respect to M's rows, times ``weight``."""
    xx, yy, _, raw, det = covariance
    common = weight * dilation * (xx + yy - dilation) / (raw * det)
    direct = -weight * dilation / det
    return linear_combination(common, cross(m2, normal), direct, m1), linear_combination(
        common, cross(normal, m1), direct, m2
    )


@inner
def _quaternion_gradient(unit, x, y, z):  # type: ignore[no-untyped-def]
    """Gradient with respect to a unit quaternion, from the gradients of rotations about the Gaussian's axes."""
    w, i, j, k = unit
    return (
        2.0 * (-i * x - j * y - k * z),
        2.0 * (w * x + j * z - k * y),
        2.0 * (w * y + k * x - i * z),
        2.0 * (w * z + i * y - j * x),
    )


@inner
def _turn_gradients(filtered, y1, y2, z1, z2, p1, p2, f1, f2):  # type: ignore[no-untyped-def]
    """Gradients of rotations about the Gaussian's three axes; f1 and f2 are gradients of M's rows beyond H's."""
    s0, s1, s2 = filtered
    x = (s1 * s1 - s2 * s2) * (y1[1] * z1[2] + y2[1] * z2[2])
    y = (s2 * s2 - s0 * s0) * (y1[2] * z1[0] + y2[2] * z2[0])
    z = (s0 * s0 - s1 * s1) * (y1[0] * z1[1] + y2[0] * z2[1])
    x += s1 * (f1[1] * p1[2] + f2[1] * p2[2]) - s2 * (f1[2] * p1[1] + f2[2] * p2[1])
    y += s2 * (f1[2] * p1[0] + f2[2] * p2[0]) - s0 * (f1[0] * p1[2] + f2[0] * p2[2])
    z += s0 * (f1[0] * p1[1] + f2[0] * p2[1]) - s1 * (f1[1] * p1[0] + f2[1] * p2[0])
    return x, y, z


@inner
def _centre_backward(point, tangents, gt1, gt2, g_pixel, g_depth, view):  # type: ignore[no-untyped-def]
    """Gradient of the camera-space centre: through the 2D mean, the Jacobian's entries and the depth itself."""
    x, y, z = point
    u, v, free_x, free_y = tangents
    W = view.rotation
    j00 = gt1[0] * W[0, 0] + gt1[1] * W[0, 1] + gt1[2] * W[0, 2]
    j02 = gt1[0] * W[2, 0] + gt1[1] * W[2, 1] + gt1[2] * W[2, 2]
    j11 = gt2[0] * W[1, 0] + gt2[1] * W[1, 1] + gt2[2] * W[1, 2]
    j12 = gt2[0] * W[2, 0] + gt2[1] * W[2, 1] + gt2[2] * W[2, 2]
    ax, ay = view.fx / z, view.fy / z
    gx, gy = ax * g_pixel[0], ay * g_pixel[1]
    gz = g_depth - (gx * x + gy * y) / z - (ax * j00 + ay * j11) / z + (ax * u * j02 + ay * v * j12) / z
    if free_x:
        gx -= ax / z * j02
        gz += ax / z * u * j02
    if free_y:
        gy -= ay / z * j12
        gz += ay / z * v * j12
    return gx, gy, gz


@kernel
def _project_backward(shape, view, dilation, mip, visible, gradients):  # type: ignore[no-untyped-def]
    n = len(shape.means)
    means = np.zeros((n, 3), np.float32)
    log_scales = np.zeros((n, 3), np.float32)
    quaternions = np.zeros((n, 4), np.float32)
    logits = np.zeros(n, np.float32)
    for g in prange(n):
        if visible[g]:
            point, tangents, _, (unit, length, R), (s, filtered, p1, p2), (m1, m2, normal), covariance, _ = ellipse_of(
                shape, g, view, dilation, mip
            )
            a, b, c, d = whitening_of(covariance[0], covariance[1], covariance[2], covariance[4])
            h = np.float64(gradients[g, 4])
            logits[g] = h / (1.0 + math.exp(np.float64(shape.opacity_logits[g])))
            uu, uv, vv = _NATURAL * gradients[g, 7], _NATURAL * gradients[g, 8], _NATURAL * gradients[g, 9]
            y1, y2 = linear_combination(a, p1, b, p2), linear_combination(c, p1, d, p2)
            z1, z2 = linear_combination(uu, y1, uv, y2), linear_combination(uv, y1, vv, y2)
            f1 = f2 = (0.0, 0.0, 0.0)
            if mip:
                f1, f2 = _filter_rows(h, m1, m2, normal, covariance, dilation)
            r1, r2 = linear_combination(a, z1, c, z2), linear_combination(b, z1, d, z2)
            n1 = (
                filtered[0] * (filtered[0] * r1[0] + f1[0]), filtered[1] * (filtered[1] * r1[1] + f1[1]),
                filtered[2] * (filtered[2] * r1[2] + f1[2]),
            )  # fmt: skip
            n2 = (
                filtered[0] * (filtered[0] * r2[0] + f2[0]), filtered[1] * (filtered[1] * r2[1] + f2[1]),
                filtered[2] * (filtered[2] * r2[2] + f2[2]),
            )  # fmt: skip
            for k in range(3):
                variance_ratio = (s[k] / filtered[k]) ** 2
                by_width = filtered[k] * (filtered[k] * (y1[k] * z1[k] + y2[k] * z2[k]) + f1[k] * p1[k] + f2[k] * p2[k])
                log_scales[g, k] = variance_ratio * by_width + h * (1.0 - variance_ratio)
            x, y, z = _turn_gradients(filtered, y1, y2, z1, z2, p1, p2, f1, f2)
            by_quaternion = _quaternion_gradient(unit, x, y, z)
            for k in range(4):
                quaternions[g, k] = by_quaternion[k] / length
            hu, hv = math.sqrt(_NATURAL) * gradients[g, 5], math.sqrt(_NATURAL) * gradients[g, 6]
            pixel = a * hu + c * hv, b * hu + d * hv
            gt1, gt2 = (dot(R[0], n1), dot(R[1], n1), dot(R[2], n1)), (dot(R[0], n2), dot(R[1], n2), dot(R[2], n2))
            x, y, z = _centre_backward(point, tangents, gt1, gt2, pixel, np.float64(gradients[g, 3]), view)
            W = view.rotation
            means[g, 0] = W[0, 0] * x + W[1, 0] * y + W[2, 0] * z
            means[g, 1] = W[0, 1] * x + W[1, 1] * y + W[2, 1] * z
            means[g, 2] = W[0, 2] * x + W[1, 2] * y + W[2, 2] * z
    return means, log_scales, quaternions, logits
