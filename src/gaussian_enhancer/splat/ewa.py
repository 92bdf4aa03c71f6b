"""Ellipsoids to ellipses on the image (3DGS and Mip-Splatting), forward and analytic backward, on the CPU.

Axes: n Gaussians. With W the world-to-camera rotation, J the perspective's Jacobian at the (clamped) centre, R and s
the Gaussian's rotation and scales, the rows m1, m2 of M = J W R diag(s) give

    cov2d = M M^T + d I,   det = |m1 x m2|^2 + d (|m1|^2 + |m2|^2) + d^2

The second form does not cancel, so that needles of any axis ratio keep a positive determinant. All of this is in
float64; what the rasteriser reads is float32. Non-finite Gaussians are nowhere visible, as are those with z <= near.

Sources: Zwicker et al., EWA Splatting, 2002; Kerbl et al. 2023, appendix A; Yu et al., Mip-Splatting, 2024, eq. 9, 10.
The clamp of x/z and y/z is gsplat's: 0.3 half fields of view beyond the image's own edges.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64
from numba import prange

from gaussian_enhancer.splat.compiled import ALPHA_MIN, inner, kernel, kernel_lock
from gaussian_enhancer.types import Camera

_LARGEST = 1e100  # of a determinant in pixels; beyond, the Gaussian is taken for not finite
_WHITE = math.sqrt(0.5 * math.log2(math.e))  # exp(-q/2) = 2^-(WHITE^2 q)


class View(NamedTuple):
    """A camera as the kernels take it, float64."""

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
    """What is known of each Gaussian on the image.

    Attributes:
        footprints: see `splat.tiles`; half_width 0 where culled.
        whitening: (a, b, c, l): alpha = 2^(l - u^2 - v^2) with u = a dx + b dy, v = c dy and dx, dy in pixels.
        depths: centre z.
        radii: three standard deviations of the longer axis in pixels, 0 where culled.
    """

    footprints: Float64[np.ndarray, "n 6"]
    whitening: Float32[np.ndarray, "n 4"]
    depths: Float32[np.ndarray, " n"]
    radii: Float32[np.ndarray, " n"]


class ShapeGradient(NamedTuple):
    """Gradients of the loss with respect to the members of `Shape` that are learnt."""

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
        mip: whether the 2D filter keeps the energy and ``smoothing`` applies (Mip-Splatting).
    """
    with kernel_lock:
        return Projection(*_project(shape, view, dilation, mip))


def project_backward(
    shape: Shape,
    view: View,
    dilation: float,
    mip: bool,
    wanted: Bool[np.ndarray, " n"],
    image: Float32[np.ndarray, "n 12"],
) -> ShapeGradient:
    """Pull gradients back from the image to the parameters.

    Args:
        shape: as in `project`.
        view: as in `project`.
        dilation: as in `project`.
        mip: as in `project`.
        wanted: Gaussians that are in some tile; the others' gradients are 0.
        image: what `splat.raster.blend_backward` gathered, summed over tiles.
    """
    with kernel_lock:
        return ShapeGradient(*_project_backward(shape, view, dilation, mip, wanted, image))


def screen_gradients(
    whitening: Float32[np.ndarray, "n 4"], image: Float32[np.ndarray, "n 12"]
) -> tuple[Float32[np.ndarray, "n 2"], Float32[np.ndarray, "n 2"]]:
    """Gradient with respect to the 2D mean in pixels, and the same with every pixel's share taken absolute (AbsGS)."""
    a, b, c = whitening[:, 0], whitening[:, 1], whitening[:, 2]
    scale = np.float32(2.0 * math.log(2.0))
    signed = np.stack([a * image[:, 5], b * image[:, 5] + c * image[:, 6]], axis=1) * scale
    absolute = np.stack([np.abs(a) * image[:, 10], image[:, 11]], axis=1) * scale
    return signed, absolute


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
    """Gradient with respect to the unit quaternion, from that of the matrix (rows of ``g``)."""
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
    """A centre in camera axes."""
    R, t = view.rotation, view.translation
    a, b, c = np.float64(means[g, 0]), np.float64(means[g, 1]), np.float64(means[g, 2])
    return (
        R[0, 0] * a + R[0, 1] * b + R[0, 2] * c + t[0],
        R[1, 0] * a + R[1, 1] * b + R[1, 2] * c + t[1],
        R[2, 0] * a + R[2, 1] * b + R[2, 2] * c + t[2],
    )


@inner
def _clamped(x, y, z, view):  # type: ignore[no-untyped-def]
    """Tangents x/z and y/z kept within the widened field of view, and whether each is its own."""
    beyond_x, beyond_y = 0.15 * view.width / view.fx, 0.15 * view.height / view.fy
    p, q = x / z, y / z
    u = min(max(p, -view.cx / view.fx - beyond_x), (view.width - view.cx) / view.fx + beyond_x)
    v = min(max(q, -view.cy / view.fy - beyond_y), (view.height - view.cy) / view.fy + beyond_y)
    return u, v, u == p, v == q


@inner
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner
def _cross(a, b):  # type: ignore[no-untyped-def]
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inner
def _mix(p, a, q, b):  # type: ignore[no-untyped-def]
    return p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2]


@inner
def _scales(shape, g, mip):  # type: ignore[no-untyped-def]
    """Standard deviations after the 3D filter, and the factor on opacity that keeps the energy."""
    s = math.exp(shape.log_scales[g, 0]), math.exp(shape.log_scales[g, 1]), math.exp(shape.log_scales[g, 2])
    if not mip:
        return s, s, 1.0
    f = np.float64(shape.smoothing[g])
    wide = math.sqrt(s[0] * s[0] + f * f), math.sqrt(s[1] * s[1] + f * f), math.sqrt(s[2] * s[2] + f * f)
    return s, wide, (s[0] / wide[0]) * (s[1] / wide[1]) * (s[2] / wide[2])


@inner
def _ellipse(shape, g, view, dilation, mip):  # type: ignore[no-untyped-def]
    """What forward and backward share: camera point, tangents, rows of J W, R and M, scales, opacity factor."""
    x, y, z = camera_point(shape.means, g, view)
    tangents = _clamped(x, y, z, view)
    u, v, _, _ = tangents
    W = view.rotation
    row = W[2, 0], W[2, 1], W[2, 2]
    t1 = _mix(view.fx / z, (W[0, 0], W[0, 1], W[0, 2]), -view.fx * u / z, row)
    t2 = _mix(view.fy / z, (W[1, 0], W[1, 1], W[1, 2]), -view.fy * v / z, row)
    q = shape.quaternions
    qw, qx, qy, qz = np.float64(q[g, 0]), np.float64(q[g, 1]), np.float64(q[g, 2]), np.float64(q[g, 3])
    length = math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    unit = qw / length, qx / length, qy / length, qz / length
    R = rotation_of(unit[0], unit[1], unit[2], unit[3])
    s, wide, factor = _scales(shape, g, mip)
    p1 = _mix(t1[0], R[0], t1[1], R[1])
    p2 = _mix(t2[0], R[0], t2[1], R[1])
    p1, p2 = _mix(1.0, p1, t1[2], R[2]), _mix(1.0, p2, t2[2], R[2])
    m1 = p1[0] * wide[0], p1[1] * wide[1], p1[2] * wide[2]
    m2 = p2[0] * wide[0], p2[1] * wide[1], p2[2] * wide[2]
    normal = _cross(m1, m2)
    raw = _dot(normal, normal)
    xx, yy, xy = _dot(m1, m1), _dot(m2, m2), _dot(m1, m2)
    det = raw + dilation * (xx + yy) + dilation * dilation
    if mip:
        factor *= math.sqrt(raw / det)
    return (x, y, z), tangents, (t1, t2), (unit, length, R), (s, wide), (m1, m2, normal), (xx, yy, xy, raw, det), factor


@kernel
def _project(shape, view, dilation, mip):  # type: ignore[no-untyped-def]
    n = len(shape.means)
    footprints = np.zeros((n, 6))
    whitening = np.zeros((n, 4), np.float32)
    depths = np.zeros(n, np.float32)
    radii = np.zeros(n, np.float32)
    for g in prange(n):
        z = camera_point(shape.means, g, view)[2]
        depths[g] = z
        if z > view.near:
            (x, y, z), _, _, _, _, _, (xx, yy, xy, _, det), factor = _ellipse(shape, g, view, dilation, mip)
            xx, yy = xx + dilation, yy + dilation
            opacity = factor / (1.0 + math.exp(-np.float64(shape.opacity_logits[g])))
            if opacity >= ALPHA_MIN and det > 0.0 and abs(x) + abs(y) + det <= _LARGEST:
                r = math.sqrt(2.0 * math.log(opacity / ALPHA_MIN))
                footprints[g, 0] = view.fx * x / z + view.cx
                footprints[g, 1] = view.fy * y / z + view.cy
                footprints[g, 2] = r * math.sqrt(xx) + 1e-9
                footprints[g, 3] = r * math.sqrt(yy) + 1e-9
                footprints[g, 4] = xy / xx
                footprints[g, 5] = r * math.sqrt(det / xx)
                whitening[g, 0] = _WHITE * math.sqrt(yy / det)
                whitening[g, 1] = -_WHITE * xy / math.sqrt(yy * det)
                whitening[g, 2] = _WHITE / math.sqrt(yy)
                whitening[g, 3] = math.log2(opacity)
                half = 0.5 * (xx - yy)
                radii[g] = 3.0 * math.sqrt(0.5 * (xx + yy) + math.sqrt(half * half + xy * xy))
    return footprints, whitening, depths, radii


@inner
def _to_rows(image, g, a, b, c, m1, m2):  # type: ignore[no-untyped-def]
    """Gradients of M's rows, from whitened second moments: dL/dcov = L (sum h w w^T) L^T / 2, w = (u, v) / WHITE."""
    k = math.log(2.0)
    uu, uv, vv = np.float64(image[g, 7]), np.float64(image[g, 8]), np.float64(image[g, 9])
    g_xx = k * a * a * uu
    g_xy = k * a * (b * uu + c * uv)
    g_yy = k * (b * b * uu + 2.0 * b * c * uv + c * c * vv)
    return _mix(2.0 * g_xx, m1, 2.0 * g_xy, m2), _mix(2.0 * g_yy, m2, 2.0 * g_xy, m1)


@inner
def _filter_rows(g1, g2, weight, m1, m2, normal, raw, det, dilation):  # type: ignore[no-untyped-def]
    """Add the gradient of log sqrt(raw / det), Mip-Splatting's 2D factor, times ``weight``."""
    common = weight * (1.0 / raw - 1.0 / det)
    toward1, toward2 = _cross(m2, normal), _cross(normal, m1)
    direct = -weight * dilation / det
    g1 = _mix(1.0, g1, 1.0, _mix(common, toward1, direct, m1))
    g2 = _mix(1.0, g2, 1.0, _mix(common, toward2, direct, m2))
    return g1, g2


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
def _project_backward(shape, view, dilation, mip, wanted, image):  # type: ignore[no-untyped-def]
    n = len(shape.means)
    means = np.zeros((n, 3), np.float32)
    log_scales = np.zeros((n, 3), np.float32)
    quaternions = np.zeros((n, 4), np.float32)
    logits = np.zeros(n, np.float32)
    for g in prange(n):
        if wanted[g]:
            point, tangents, (t1, t2), (unit, length, R), (s, wide), (m1, m2, normal), sums, _ = _ellipse(
                shape, g, view, dilation, mip
            )
            xx, yy, xy, raw, det = sums
            xx, yy = xx + dilation, yy + dilation
            a, b, c = math.sqrt(yy / det), -xy / math.sqrt(yy * det), 1.0 / math.sqrt(yy)
            h = np.float64(image[g, 4])
            logits[g] = h / (1.0 + math.exp(np.float64(shape.opacity_logits[g])))
            g1, g2 = _to_rows(image, g, a, b, c, m1, m2)
            if mip:
                g1, g2 = _filter_rows(g1, g2, h, m1, m2, normal, raw, det, dilation)
            k = math.sqrt(2.0 * math.log(2.0))
            hu, hv = k * np.float64(image[g, 5]), k * np.float64(image[g, 6])
            n1 = g1[0] * wide[0], g1[1] * wide[1], g1[2] * wide[2]
            n2 = g2[0] * wide[0], g2[1] * wide[1], g2[2] * wide[2]
            gR0, gR1, gR2 = _mix(t1[0], n1, t2[0], n2), _mix(t1[1], n1, t2[1], n2), _mix(t1[2], n1, t2[2], n2)
            gt1 = _dot(R[0], n1), _dot(R[1], n1), _dot(R[2], n1)
            gt2 = _dot(R[0], n2), _dot(R[1], n2), _dot(R[2], n2)
            gw, gx, gy, gz = rotation_backward(unit[0], unit[1], unit[2], unit[3], (gR0, gR1, gR2))
            radial = gw * unit[0] + gx * unit[1] + gy * unit[2] + gz * unit[3]
            quaternions[g, 0] = (gw - radial * unit[0]) / length
            quaternions[g, 1] = (gx - radial * unit[1]) / length
            quaternions[g, 2] = (gy - radial * unit[2]) / length
            quaternions[g, 3] = (gz - radial * unit[3]) / length
            for k_axis in range(3):
                keep = (s[k_axis] / wide[k_axis]) ** 2
                log_scales[g, k_axis] = keep * (g1[k_axis] * m1[k_axis] + g2[k_axis] * m2[k_axis]) + h * (1.0 - keep)
            pixel = a * hu, b * hu + c * hv
            gx, gy, gz = _centre_backward(point, tangents, gt1, gt2, pixel, np.float64(image[g, 3]), view)
            W = view.rotation
            means[g, 0] = W[0, 0] * gx + W[1, 0] * gy + W[2, 0] * gz
            means[g, 1] = W[0, 1] * gx + W[1, 1] * gy + W[2, 1] * gz
            means[g, 2] = W[0, 2] * gx + W[1, 2] * gy + W[2, 2] * gz
    return means, log_scales, quaternions, logits
