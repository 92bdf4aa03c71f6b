"""Projection of disks to the values that the rasteriser needs (2DGS), forward and analytic backward, on the CPU.

Axes: n Gaussians. Symbols, for one disk and one camera: p centre in camera axes, t_u and t_v tangents scaled by the
standard deviations, f focal lengths, d = (d_x, d_y) a pixel's offset from the projected centre.

Huang et al. (2D Gaussian Splatting, SIGGRAPH 2024, equations 8 to 10) intersect ray and disk as the cross product of
two homogeneous planes in pixel coordinates, which cancels badly in float32. Measured from the projected centre and
divided by p_z, the planes are k = (a_u + w_u d_x, a_v + w_v d_x, d_x) and l = (b_u + w_u d_y, b_v + w_v d_y, d_y) with

    w = t_z / p_z,   a = f_x (p_x/p_z w - t_x / p_z),   b = f_y (p_y/p_z w - t_y / p_z)      (each for u and v)

and their cross product, in which the products d_x d_y cancel, is linear in d:

    (u, v) = C d / D,   z = p_z D_0 / D,   C = ((-b_v, a_v), (b_u, -a_u)),   D = D_0 + D_x d_x + D_y d_y,
    D_0 = a_u b_v - a_v b_u,   D_x = w_u b_v - w_v b_u,   D_y = a_u w_v - a_v w_u.

C and D are stored divided by the largest of |a| and |b|, with the sign that makes D_0 >= 0. This prevents overflow and
underflow. An edge-on disk (D_0 = 0) causes no division by zero: it never lies beyond the near plane, since the test
z = p_z D_0 / D > near fails. All of this is in float64. Disks that are not finite or have z <= near are invisible.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64
from numba import prange

from gaussian_enhancer.compiled import inner, kernel, kernel_lock
from gaussian_enhancer.splat.ewa import Shape, ShapeGradient, View, camera_point, rotation_backward, rotation_of
from gaussian_enhancer.splat.thresholds import ALPHA_MIN

_IN_FRONT = 1e-4  # of 1 - r^2 |w|^2; below it the support reaches the camera plane and may cover any pixel
_FINITE = 1e300
_EVERYWHERE = 1e7  # half the side in pixels of the bounding box of such a support


class Disks(NamedTuple):
    """Disks projected to the image.

    Attributes:
        footprints: where alpha can reach 1/255, see `splat.tiles`; half_width is 0 for culled disks.
        geometry: projected centre x, y; C row by row; D_0, D_x, D_y; float64, as centres may be far away.
        peaks: log2 of the opacity.
        depths: z of the centres.
        normals: unit normals in camera axes that face the camera.
    """

    footprints: Float64[np.ndarray, "n 6"]
    geometry: Float64[np.ndarray, "n 9"]
    peaks: Float32[np.ndarray, " n"]
    depths: Float32[np.ndarray, " n"]
    normals: Float32[np.ndarray, "n 3"]


def project_disks(shape: Shape, view: View) -> Disks:
    """Project every disk.

    Args:
        shape: the Gaussians, ``log_scales`` with two columns; ``smoothing`` is not used.
        view: the camera.
    """
    with kernel_lock:
        return Disks(*_project(shape, view))


def project_disks_backward(
    shape: Shape, view: View, visible: Bool[np.ndarray, " n"], gradients: Float32[np.ndarray, "n 20"]
) -> ShapeGradient:
    """Gradients with respect to the disks' parameters, from the gradients that the rasteriser returns.

    The divisor of C and D is treated as constant, since scaling both changes neither (u, v) nor z.

    Args:
        shape: as in `project_disks`.
        view: as in `project_disks`.
        visible: mask of the Gaussians that some tile lists; the others' gradients are 0.
        gradients: result of `splat.raster_disks.blend_disks_backward`, summed over tiles.
    """
    with kernel_lock:
        return ShapeGradient(*_project_backward(shape, view, visible, gradients))


@inner
def _frame(shape, g, view):  # type: ignore[no-untyped-def]
    """Centre in camera axes, the disk's axes in camera axes (rows: x, y, z), unit quaternion and its length."""
    q = shape.quaternions
    w, x, y, z = np.float64(q[g, 0]), np.float64(q[g, 1]), np.float64(q[g, 2]), np.float64(q[g, 3])
    length = math.sqrt(w * w + x * x + y * y + z * z)
    length = length if length > 0.0 else math.nan
    unit = w / length, x / length, y / length, z / length
    R = rotation_of(unit[0], unit[1], unit[2], unit[3])
    W = view.rotation
    axes = (
        _times_matrix(W[0, 0], W[0, 1], W[0, 2], R),
        _times_matrix(W[1, 0], W[1, 1], W[1, 2], R),
        _times_matrix(W[2, 0], W[2, 1], W[2, 2], R),
    )
    return camera_point(shape.means, g, view), axes, unit, length


@inner
def _times_matrix(a, b, c, R):  # type: ignore[no-untyped-def]
    """The row (a, b, c) times the matrix R."""
    return (
        a * R[0][0] + b * R[1][0] + c * R[2][0],
        a * R[0][1] + b * R[1][1] + c * R[2][1],
        a * R[0][2] + b * R[1][2] + c * R[2][2],
    )


@inner
def _planes(shape, g, view, p, axes):  # type: ignore[no-untyped-def]
    """Scales divided by p_z; a, b, w as (u, v) pairs; D_0; the factor by which C and D are multiplied."""
    px, py = p[0] / p[2], p[1] / p[2]
    su, sv = math.exp(np.float64(shape.log_scales[g, 0])) / p[2], math.exp(np.float64(shape.log_scales[g, 1])) / p[2]
    w = su * axes[2][0], sv * axes[2][1]
    a = view.fx * (px * w[0] - su * axes[0][0]), view.fx * (px * w[1] - sv * axes[0][1])
    b = view.fy * (py * w[0] - su * axes[1][0]), view.fy * (py * w[1] - sv * axes[1][1])
    determinant = a[0] * b[1] - a[1] * b[0]
    factor = 1.0 / max(max(abs(a[0]), abs(a[1])), max(max(abs(b[0]), abs(b[1])), 1e-150))
    return (su, sv), a, b, w, determinant, (-factor if determinant < 0.0 else factor)


@inner
def _footprint(x, y, a, b, w, square):  # type: ignore[no-untyped-def]
    """An ellipse around all points where alpha can reach 1/255: the projected disk of radius r and the low-pass circle.

    The image of the circle |(u, v)| = r has centre m = r^2 (a.w, b.w) / k and, with k = 1 - r^2 w.w > 0, matrix
    S = r^2 ((a.a, a.b), (a.b, b.b)) / k + m m^T. Its half axes are raised to at least r / sqrt(2) + |m|, r / sqrt(2)
    being the radius of the low-pass circle, so that the ellipse covers both. ``square`` is r^2.
    """
    k = 1.0 - square * (w[0] * w[0] + w[1] * w[1])
    if not k > _IN_FRONT:
        return x, y, _EVERYWHERE, _EVERYWHERE, 0.0, -1.0
    mx, my = square * (a[0] * w[0] + a[1] * w[1]) / k, square * (b[0] * w[0] + b[1] * w[1]) / k
    sxx = square * (a[0] * a[0] + a[1] * a[1]) / k + mx * mx
    sxy = square * (a[0] * b[0] + a[1] * b[1]) / k + mx * my
    syy = square * (b[0] * b[0] + b[1] * b[1]) / k + my * my
    smallest_square = (math.sqrt(0.5 * square) + math.sqrt(mx * mx + my * my)) ** 2
    middle, half = 0.5 * (sxx + syy), 0.5 * (sxx - syy)
    spread = math.sqrt(half * half + sxy * sxy)
    long, short = max(middle + spread, smallest_square), max(middle - spread, smallest_square)
    turn = 0.5 * (long - short) / spread if spread > 0.0 else 0.0
    sxx, sxy, syy = 0.5 * (long + short) + turn * half, turn * sxy, 0.5 * (long + short) - turn * half
    return x + mx, y + my, math.sqrt(sxx) + 1e-9, math.sqrt(syy) + 1e-9, sxy / sxx, math.sqrt(long * short / sxx)


@kernel
def _project(shape, view):  # type: ignore[no-untyped-def]
    n = len(shape.means)
    footprints, geometry = np.zeros((n, 6)), np.zeros((n, 9))
    peaks, depths, normals = np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros((n, 3), np.float32)
    for g in prange(n):
        z = camera_point(shape.means, g, view)[2]
        depths[g] = z
        opacity = 1.0 / (1.0 + math.exp(-np.float64(shape.opacity_logits[g])))
        if z > view.near and opacity > ALPHA_MIN:
            p, axes, _, _ = _frame(shape, g, view)
            _, a, b, w, determinant, factor = _planes(shape, g, view, p, axes)
            x, y = view.fx * p[0] / z + view.cx, view.fy * p[1] / z + view.cy
            # Not math.isfinite: it subtracts, and reassociated terms cancel.
            if not abs(x) + abs(y) + abs(determinant) + abs(w[0]) + abs(w[1]) < _FINITE:
                continue
            footprint = _footprint(x, y, a, b, w, 2.0 * math.log(opacity / ALPHA_MIN))
            for k in range(6):
                footprints[g, k] = footprint[k]
            geometry[g, 0], geometry[g, 1] = x, y
            geometry[g, 2], geometry[g, 3] = -b[1] * factor, a[1] * factor
            geometry[g, 4], geometry[g, 5] = b[0] * factor, -a[0] * factor
            geometry[g, 6] = determinant * factor
            geometry[g, 7], geometry[g, 8] = (w[0] * b[1] - w[1] * b[0]) * factor, (a[0] * w[1] - a[1] * w[0]) * factor
            peaks[g] = math.log2(opacity)
            facing_sign = -1.0 if axes[0][2] * p[0] + axes[1][2] * p[1] + axes[2][2] * p[2] > 0.0 else 1.0
            for r in range(3):
                normals[g, r] = facing_sign * axes[r][2]
    return footprints, geometry, peaks, depths, normals


@inner
def _tangents_backward(p, axes, view, planes, gradients, g):  # type: ignore[no-untyped-def]
    """Gradients of the camera-space centre, of both unit tangents (x, y, z) and of both log scales."""
    (su, sv), a, b, w, determinant, factor = planes
    z = p[2]
    px, py = p[0] / z, p[1] / z
    g0 = factor * (gradients[g, 9] + z * gradients[g, 12])
    g1, g2 = factor * gradients[g, 10], factor * gradients[g, 11]
    gau = -factor * gradients[g, 8] + g0 * b[1] + g2 * w[1]
    gav = factor * gradients[g, 6] - g0 * b[0] - g2 * w[0]
    gbu = factor * gradients[g, 7] - g0 * a[1] - g1 * w[1]
    gbv = -factor * gradients[g, 5] + g0 * a[0] + g1 * w[0]
    gwu = g1 * b[1] - g2 * a[1] + view.fx * px * gau + view.fy * py * gbu
    gwv = -g1 * b[0] + g2 * a[0] + view.fx * px * gav + view.fy * py * gbv
    gu = -su * view.fx * gau, -su * view.fy * gbu, su * gwu
    gv = -sv * view.fx * gav, -sv * view.fy * gbv, sv * gwv
    scale_u = gu[0] * axes[0][0] + gu[1] * axes[1][0] + gu[2] * axes[2][0]
    scale_v = gv[0] * axes[0][1] + gv[1] * axes[1][1] + gv[2] * axes[2][1]
    gx = view.fx * (gau * w[0] + gav * w[1] + gradients[g, 3])
    gy = view.fy * (gbu * w[0] + gbv * w[1] + gradients[g, 4])
    gz = gradients[g, 13] + determinant * factor * gradients[g, 12] - (scale_u + scale_v + gx * px + gy * py) / z
    return (gx / z, gy / z, gz), gu, gv, (scale_u, scale_v)


@kernel
def _project_backward(shape, view, visible, gradients):  # type: ignore[no-untyped-def]
    n = len(shape.means)
    means, log_scales = np.zeros((n, 3), np.float32), np.zeros((n, 2), np.float32)
    quaternions, logits = np.zeros((n, 4), np.float32), np.zeros(n, np.float32)
    for g in prange(n):
        if visible[g]:
            p, axes, unit, length = _frame(shape, g, view)
            planes = _planes(shape, g, view, p, axes)
            gp, gu, gv, scales = _tangents_backward(p, axes, view, planes, gradients, g)
            logits[g] = gradients[g, 14] / (1.0 + math.exp(np.float64(shape.opacity_logits[g])))
            log_scales[g, 0], log_scales[g, 1] = scales
            facing_sign = -1.0 if axes[0][2] * p[0] + axes[1][2] * p[1] + axes[2][2] * p[2] > 0.0 else 1.0
            gn = facing_sign * gradients[g, 15], facing_sign * gradients[g, 16], facing_sign * gradients[g, 17]
            W = view.rotation
            rows = (
                _column(W, 0, gu, gv, gn),
                _column(W, 1, gu, gv, gn),
                _column(W, 2, gu, gv, gn),
            )
            gw, gx, gy, gz = rotation_backward(unit[0], unit[1], unit[2], unit[3], rows)
            radial = gw * unit[0] + gx * unit[1] + gy * unit[2] + gz * unit[3]
            quaternions[g, 0] = (gw - radial * unit[0]) / length
            quaternions[g, 1] = (gx - radial * unit[1]) / length
            quaternions[g, 2] = (gy - radial * unit[2]) / length
            quaternions[g, 3] = (gz - radial * unit[3]) / length
            for r in range(3):
                means[g, r] = W[0, r] * gp[0] + W[1, r] * gp[1] + W[2, r] * gp[2]
    return means, log_scales, quaternions, logits


@inner
def _column(W, r, gu, gv, gn):  # type: ignore[no-untyped-def]
    """Row r of the gradient of the disk's rotation: column r of W against the gradients of the three axes."""
    return (
        W[0, r] * gu[0] + W[1, r] * gu[1] + W[2, r] * gu[2],
        W[0, r] * gv[0] + W[1, r] * gv[1] + W[2, r] * gv[2],
        W[0, r] * gn[0] + W[1, r] * gn[1] + W[2, r] * gn[2],
    )
