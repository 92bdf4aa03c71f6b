"""Projection of ellipsoids to ellipses in the image (3DGS and Mip-Splatting) on the CPU.

Axes: n Gaussians. With W the world-to-camera rotation, J the perspective's Jacobian at the (clamped) centre, R and s
the Gaussian's rotation and scales, the rows m1, m2 of M = J W R diag(s) give

    cov2d = M M^T + d I,   det = |m1 x m2|^2 + d (|m1|^2 + |m2|^2) + d^2

This form of the determinant has no cancelling terms, so that needles of any axis ratio keep a positive determinant. For
the same reason the footprint is whitened along its principal axes. All of this is in float64. Gaussians that are not
finite or have z <= near are invisible.

Sources: Zwicker et al., EWA Splatting, 2002; Kerbl et al. 2023, appendix A; Yu et al., Mip-Splatting, 2024, eq. 9, 10.
The clamp of x/z and y/z is gsplat's: 0.3 half fields of view beyond the image's edges. The backward is in
`splat.ewa_backward`.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64
from numba import prange

from gaussian_enhancer.compiled import inner, kernel, kernel_lock
from gaussian_enhancer.splat.thresholds import ALPHA_MIN
from gaussian_enhancer.types import Camera

_LARGEST = 1e100  # of |x| + |y| + det; beyond it a Gaussian counts as not finite
_WHITENING_SCALE = math.sqrt(0.5 * math.log2(math.e))  # exp(-q/2) = 2^-(scale^2 q)


class View(NamedTuple):
    """A camera in the form that the kernels take, in float64."""

    rotation: Float64[np.ndarray, "3 3"]
    translation: Float64[np.ndarray, " 3"]
    centre: Float64[np.ndarray, " 3"]
    fx: float
    fy: float
    cx: float
    cy: float
    height: int
    width: int
    near: float


class Shape(NamedTuple):
    """The geometry of n Gaussians as contiguous float32 arrays.

    Attributes:
        means: centres.
        log_scales: logarithms of the standard deviations.
        quaternions: (w, x, y, z), any length.
        opacity_logits: opacity before the sigmoid.
        smoothing: 3D filter of Mip-Splatting; zeros elsewhere.
    """

    means: Float32[np.ndarray, "n 3"]
    log_scales: Float32[np.ndarray, "n 3"]
    quaternions: Float32[np.ndarray, "n 4"]
    opacity_logits: Float32[np.ndarray, " n"]
    smoothing: Float32[np.ndarray, " n"]


class Projection(NamedTuple):
    """The Gaussians projected to the image.

    Attributes:
        footprints: see `splat.tiles`; half_width is 0 for culled Gaussians.
        whitening: (a, b, c, d, l): alpha = 2^(l - u^2 - v^2) with u = a dx + b dy along the footprint's minor axis and
            v = c dx + d dy along its major one, dx and dy in pixels from its centre.
        depths: z of the centres.
    """

    footprints: Float64[np.ndarray, "n 6"]
    whitening: Float64[np.ndarray, "n 5"]
    depths: Float32[np.ndarray, " n"]


class ShapeGradient(NamedTuple):
    """Gradients of the loss with respect to the members of `Shape` that are optimised."""

    means: Float32[np.ndarray, "n 3"]
    log_scales: Float32[np.ndarray, "n 3"]
    quaternions: Float32[np.ndarray, "n 4"]
    opacity_logits: Float32[np.ndarray, " n"]


def view_of(camera: Camera, near: float) -> View:
    """Unpack a camera for the kernels."""
    K = camera.K.detach().cpu().double().numpy()
    pose = camera.world_to_camera.detach().cpu().double().numpy()
    rotation, translation = np.ascontiguousarray(pose[:3, :3]), np.ascontiguousarray(pose[:3, 3])
    return View(
        rotation, translation, -rotation.T @ translation,
        float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), camera.height, camera.width, float(near),
    )  # fmt: skip


def project(shape: Shape, view: View, dilation: float, mip: bool) -> Projection:
    """Project Gaussians to footprints.

    Args:
        shape: the Gaussians.
        view: the camera.
        dilation: variance d in square pixels that is added to both axes.
        mip: whether the 2D filter preserves energy and ``smoothing`` is applied (Mip-Splatting).
    """
    with kernel_lock:
        return Projection(*_project(shape, view, dilation, mip))


@inner
def rotation_of(w, x, y, z):  # type: ignore[no-untyped-def]
    """Rotation matrix of a unit quaternion, row by row."""
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@inner
def rotation_backward(w, x, y, z, g):  # type: ignore[no-untyped-def]
    """Gradient with respect to the unit quaternion, from the gradient ``g`` of the rotation matrix, row by row."""
    minus = g[2][1] - g[1][2], g[0][2] - g[2][0], g[1][0] - g[0][1]
    plus = g[2][1] + g[1][2], g[0][2] + g[2][0], g[1][0] + g[0][1]
    return (
        2.0 * (x * minus[0] + y * minus[1] + z * minus[2]),
        2.0 * (w * minus[0] + y * plus[2] + z * plus[1] - 2.0 * x * (g[1][1] + g[2][2])),
        2.0 * (w * minus[1] + x * plus[2] + z * plus[0] - 2.0 * y * (g[0][0] + g[2][2])),
        2.0 * (w * minus[2] + x * plus[1] + y * plus[0] - 2.0 * z * (g[0][0] + g[1][1])),
    )


@inner
def camera_point(means, g, view):  # type: ignore[no-untyped-def]
    """Centre of Gaussian ``g`` in camera axes."""
    R, t = view.rotation, view.translation
    a, b, c = np.float64(means[g, 0]), np.float64(means[g, 1]), np.float64(means[g, 2])
    return (
        R[0, 0] * a + R[0, 1] * b + R[0, 2] * c + t[0],
        R[1, 0] * a + R[1, 1] * b + R[1, 2] * c + t[1],
        R[2, 0] * a + R[2, 1] * b + R[2, 2] * c + t[2],
    )


@inner
def _clamp_tangents(x, y, z, view):  # type: ignore[no-untyped-def]
    """Tangents x/z and y/z clamped to the widened field of view, and whether each was left unchanged."""
    beyond_x, beyond_y = 0.15 * view.width / view.fx, 0.15 * view.height / view.fy
    p, q = x / z, y / z
    u = min(max(p, -view.cx / view.fx - beyond_x), (view.width - view.cx) / view.fx + beyond_x)
    v = min(max(q, -view.cy / view.fy - beyond_y), (view.height - view.cy) / view.fy + beyond_y)
    return u, v, u == p, v == q


@inner
def dot(a, b):  # type: ignore[no-untyped-def]
    """Scalar product of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner
def cross(a, b):  # type: ignore[no-untyped-def]
    """Vector product of two triples."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inner
def linear_combination(p, a, q, b):  # type: ignore[no-untyped-def]
    """The triple p a + q b."""
    return p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2]


@inner
def _scales(shape, g, mip):  # type: ignore[no-untyped-def]
    """Standard deviations after the 3D filter, and the factor on opacity that preserves energy."""
    logs = shape.log_scales
    s = math.exp(np.float64(logs[g, 0])), math.exp(np.float64(logs[g, 1])), math.exp(np.float64(logs[g, 2]))
    if not mip:
        return s, s, 1.0
    f = np.float64(shape.smoothing[g])
    filtered = math.sqrt(s[0] * s[0] + f * f), math.sqrt(s[1] * s[1] + f * f), math.sqrt(s[2] * s[2] + f * f)
    return s, filtered, (s[0] / filtered[0]) * (s[1] / filtered[1]) * (s[2] / filtered[2])


@inner
def ellipse_of(shape, g, view, dilation, mip):  # type: ignore[no-untyped-def]
    """Values that forward and backward share: camera point, tangents, rows of J W, R and M, scales, opacity factor."""
    x, y, z = camera_point(shape.means, g, view)
    tangents = _clamp_tangents(x, y, z, view)
    u, v, _, _ = tangents
    W = view.rotation
    row = W[2, 0], W[2, 1], W[2, 2]
    t1 = linear_combination(view.fx / z, (W[0, 0], W[0, 1], W[0, 2]), -view.fx * u / z, row)
    t2 = linear_combination(view.fy / z, (W[1, 0], W[1, 1], W[1, 2]), -view.fy * v / z, row)
    q = shape.quaternions
    qw, qx, qy, qz = np.float64(q[g, 0]), np.float64(q[g, 1]), np.float64(q[g, 2]), np.float64(q[g, 3])
    length = math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    unit = qw / length, qx / length, qy / length, qz / length
    R = rotation_of(unit[0], unit[1], unit[2], unit[3])
    s, filtered, factor = _scales(shape, g, mip)
    p1 = linear_combination(t1[0], R[0], t1[1], R[1])
    p2 = linear_combination(t2[0], R[0], t2[1], R[1])
    p1, p2 = linear_combination(1.0, p1, t1[2], R[2]), linear_combination(1.0, p2, t2[2], R[2])
    m1 = p1[0] * filtered[0], p1[1] * filtered[1], p1[2] * filtered[2]
    m2 = p2[0] * filtered[0], p2[1] * filtered[1], p2[2] * filtered[2]
    normal = cross(m1, m2)
    raw = dot(normal, normal)
    xx, yy, xy = dot(m1, m1), dot(m2, m2), dot(m1, m2)
    det = raw + dilation * (xx + yy) + dilation * dilation
    if mip:
        factor *= math.sqrt(raw / det)
    covariance = xx + dilation, yy + dilation, xy, raw, det
    return (x, y, z), tangents, (t1, t2), (unit, length, R), (s, filtered, p1, p2), (m1, m2, normal), covariance, factor


@inner
def whitening_of(xx, yy, xy, det):  # type: ignore[no-untyped-def]
    """Rows W of the map to unit variance, minor axis first: cov^-1 = W^T W."""
    half = 0.5 * (xx - yy)
    root = math.sqrt(half * half + xy * xy)
    major = 0.5 * (xx + yy) + root
    x, y = (half + root, xy) if half >= 0.0 else (xy, root - half)
    length = math.sqrt(x * x + y * y)
    x, y = (x / length, y / length) if length > 0.0 else (1.0, 0.0)
    steep, flat = math.sqrt(major / det), 1.0 / math.sqrt(major)
    return -y * steep, x * steep, x * flat, y * flat


@kernel
def _project(shape, view, dilation, mip):  # type: ignore[no-untyped-def]
    n = len(shape.means)
    footprints = np.zeros((n, 6))
    whitening = np.zeros((n, 5))
    depths = np.zeros(n, np.float32)
    for g in prange(n):
        z = camera_point(shape.means, g, view)[2]
        depths[g] = z
        if z > view.near:
            (x, y, z), _, _, _, _, _, (xx, yy, xy, _, det), factor = ellipse_of(shape, g, view, dilation, mip)
            opacity = factor / (1.0 + math.exp(-np.float64(shape.opacity_logits[g])))
            if opacity >= ALPHA_MIN and det > 0.0 and abs(x) + abs(y) + det <= _LARGEST:
                r = math.sqrt(2.0 * math.log(opacity / ALPHA_MIN))
                footprints[g, 0] = view.fx * x / z + view.cx
                footprints[g, 1] = view.fy * y / z + view.cy
                footprints[g, 2] = r * math.sqrt(xx) + 1e-9
                footprints[g, 3] = r * math.sqrt(yy) + 1e-9
                footprints[g, 4] = xy / xx
                footprints[g, 5] = r * math.sqrt(det / xx)
                a, b, c, d = whitening_of(xx, yy, xy, det)
                whitening[g, 0], whitening[g, 1] = _WHITENING_SCALE * a, _WHITENING_SCALE * b
                whitening[g, 2], whitening[g, 3] = _WHITENING_SCALE * c, _WHITENING_SCALE * d
                whitening[g, 4] = math.log2(opacity)
    return footprints, whitening, depths
