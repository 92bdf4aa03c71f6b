"""Reference rasteriser in plain PyTorch: every Gaussian at every pixel, in any float dtype, with autograd.

It has no tiles, no bounding boxes and no hand-written gradient. The compiled kernels and the CUDA backend are compared
with it; use float64 for such comparisons.

Axes: n Gaussians (those in front of the camera, sorted by z), k spherical-harmonics coefficients,
p pixels, h height, w width.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from gaussian_enhancer.splat.methods import Method, MipSplatting, ThreeDGS, TwoDGS, check_axes
from gaussian_enhancer.types import Camera, Gaussians, Render

ALPHA_MIN = 1 / 255
ALPHA_MAX = 0.99
TRANSMITTANCE_MIN = 1e-4
DEPTH_ALPHA_MIN = 1e-3
CLAMP_MARGIN = 0.3
DISK_LOW_PASS = 2.0
CHUNK_ELEMENTS = 2**21

SH_0 = 0.28209479177387814  # Y_0^0 = 1 / (2 sqrt(pi))
SH_1 = 0.4886025119029199
SH_2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
SH_3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


class Layers(NamedTuple):
    """Everything that compositing needs of the Gaussians seen from one camera, sorted by z; one entry per Gaussian.

    Args:
        falloff: maps pixel centres to half the squared Mahalanobis distance and to z, one row a pixel.
        opacity: peak alpha, with Mip-Splatting's compensation.
        colour: colour in the direction of the camera, not negative.
        normals: unit normals in camera axes that face the camera; None for ellipsoids.
    """

    falloff: Callable[[Float[Tensor, "p 2"]], tuple[Float[Tensor, "p n"], Float[Tensor, "p n"]]]
    opacity: Float[Tensor, " n"]
    colour: Float[Tensor, "n 3"]
    normals: Float[Tensor, "n 3"] | None


def render_oracle(
    gaussians: Gaussians,
    camera: Camera,
    method: Method,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    near: float = 0.01,
) -> Render:
    """Render one view by definition: C = sum_i c_i a_i prod_{j<i} (1 - a_j) + T background.

    Gaussians that are not finite or have z <= near are culled, the rest are sorted by their centre's z. a = min(0.99,
    opacity exp(-power)) is set to 0 below 1/255. A pixel stops before the Gaussian that would bring T below 1e-4 (Kerbl
    et al. 2023).

    Args:
        gaussians: in the dtype to compute in; three scale axes for ellipsoids, two for disks.
        camera: in the same dtype.
        method: 3DGS, 2DGS or Mip-Splatting, which determines the footprints.
        background: colour behind everything.
        near: smallest z in scene units that is drawn.

    Raises:
        InputError: if the number of scale axes does not match the method.
    """
    layers = project(gaussians, camera, method, near)
    pixels = _pixel_centres(camera, gaussians.means)
    chunks = pixels.split(max(1, CHUNK_ELEMENTS // max(1, len(layers.opacity))))

    def composite(chunk: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        return _composite(layers, chunk, background)

    if len(chunks) == 1:
        parts = [composite(chunks[0])]
    else:
        parts = [checkpoint(composite, chunk, use_reentrant=False) for chunk in chunks]
    size = (camera.height, camera.width)
    colour, depth, alpha, median, normals = (torch.cat(part).T.reshape(-1, *size) for part in zip(*parts, strict=True))
    return Render(colour, depth, alpha, median, normals if layers.normals is not None else None)


def project(gaussians: Gaussians, camera: Camera, method: Method, near: float) -> Layers:
    """Cull Gaussians, sort them by z and convert their parameters to footprints, opacities and colours."""
    check_axes(gaussians, method)
    z = (gaussians.means @ camera.rotation.T + camera.world_to_camera[:3, 3])[:, 2]
    order = torch.argsort(z.detach(), stable=True)
    visible_gaussians = gaussians[order[(z.detach()[order] > near) & _is_finite(gaussians)[order]]]
    centres = visible_gaussians.means @ camera.rotation.T + camera.world_to_camera[:3, 3]
    axes_camera = camera.rotation @ rotations(visible_gaussians.quaternions)
    directions = torch.nn.functional.normalize(visible_gaussians.means - camera.centre, dim=-1)
    colour = (sh_values(visible_gaussians.sh, directions) + 0.5).clamp_min(0)
    opacity = torch.sigmoid(visible_gaussians.opacity_logits)
    scales = torch.exp(visible_gaussians.log_scales)
    if isinstance(method, TwoDGS):
        normals = axes_camera[..., 2]
        facing_sign = torch.where((normals * centres).sum(-1, keepdim=True) > 0, -1.0, 1.0)
        return Layers(_disk_falloff(centres, axes_camera, scales, camera, near), opacity, colour, normals * facing_sign)
    if isinstance(method, MipSplatting) and visible_gaussians.smoothing is not None:
        filtered_scales = torch.sqrt(scales**2 + visible_gaussians.smoothing[:, None] ** 2)
        opacity = opacity * (scales / filtered_scales).prod(-1)
        scales = filtered_scales
    return _ellipse_layers(centres, axes_camera * scales[:, None, :], opacity, colour, camera, method)


def _is_finite(gaussians: Gaussians) -> Bool[Tensor, " n"]:
    """Mask of Gaussians with finite centres, scales and quaternions."""
    values = torch.cat([gaussians.means, gaussians.log_scales.exp(), gaussians.quaternions], -1)
    return values.isfinite().all(-1)


def _ellipse_layers(
    centres: Float[Tensor, "n 3"],
    axes: Float[Tensor, "n 3 3"],
    opacity: Float[Tensor, " n"],
    colour: Float[Tensor, "n 3"],
    camera: Camera,
    method: ThreeDGS | MipSplatting,
) -> Layers:
    """EWA splatting: cov2d = M M^T + dilation I with M = J A, A the ellipsoid's scaled axes as columns.

    det(M M^T) = |m_x cross m_y|^2 (m: rows of M) and det(cov2d) = det(M M^T) + dilation trace(M M^T) + dilation^2
    are sums of non-negative terms, so needles lose no digits to cancellation.
    """
    rows = _affine_jacobian(centres, camera) @ axes
    variances = rows.square().sum(-1)
    cross_term = (rows[:, 0] * rows[:, 1]).sum(-1)
    area = torch.linalg.vector_norm(torch.linalg.cross(rows[:, 0], rows[:, 1]), dim=-1)
    determinant = area**2 + method.dilation * variances.sum(-1) + method.dilation**2
    if isinstance(method, MipSplatting):
        opacity = opacity * area / determinant.sqrt()
    cov_x, cov_y = (variances + method.dilation).unbind(-1)
    focal, principal = camera.K.diagonal()[:2], camera.K[:2, 2]
    projected_centres = centres[:, :2] / centres[:, 2:] * focal + principal

    def falloff(pixels: Tensor) -> tuple[Tensor, Tensor]:
        x, y = (pixels[:, None] - projected_centres).unbind(-1)
        power = 0.5 * (cov_y * x**2 - 2 * cross_term * x * y + cov_x * y**2) / determinant
        return power, centres[:, 2].expand_as(power)

    return Layers(falloff, opacity, colour, None)


def _affine_jacobian(centres: Float[Tensor, "n 3"], camera: Camera) -> Float[Tensor, "n 2 3"]:
    """Derivative of the projection at each centre, x/z and y/z clamped as in gsplat.

    The limit is 0.3 half fields of view beyond the image's edges.
    """
    z = centres[:, 2]
    rows = []
    for axis, size in enumerate((camera.width, camera.height)):
        focal, principal = camera.K[axis, axis], camera.K[axis, 2]
        margin = CLAMP_MARGIN * 0.5 * size / focal
        tangent = (centres[:, axis] / z).clamp(-principal / focal - margin, (size - principal) / focal + margin)
        row = [torch.zeros_like(z), torch.zeros_like(z), -focal * tangent / z]
        row[axis] = focal / z
        rows.append(torch.stack(row, -1))
    return torch.stack(rows, -2)


def _disk_falloff(
    centres: Float[Tensor, "n 3"],
    axes: Float[Tensor, "n 3 3"],
    scales: Float[Tensor, "n 2"],
    camera: Camera,
    near: float,
) -> Callable[[Tensor], tuple[Tensor, Tensor]]:
    """Ray-splat intersection of 2DGS (Huang et al. 2024, equations 8 to 10) with its object-space low-pass.

    With H = (s_u t_u, s_v t_v, centre) as columns and the pixel's ray (x, y, 1), the planes k = x H_z - H_x and
    l = y H_z - H_y meet in (u, v, 1) ~ k cross l. Half of min(u^2 + v^2, 2 |pixel - centre|^2) is the power.
    Where no intersection exists (disk edge-on) or it lies at z <= near, the low-pass alone counts.
    """
    H = torch.cat([axes[..., :2] * scales[:, None, :], centres[..., None]], -1)
    focal, principal = camera.K.diagonal()[:2], camera.K[:2, 2]
    projected_centres = centres[:, :2] / centres[:, 2:] * focal + principal
    centre_z = centres[:, 2]

    def falloff(pixels: Tensor) -> tuple[Tensor, Tensor]:
        x, y = ((pixels - principal) / focal).unbind(-1)
        k = x[:, None, None] * H[:, 2] - H[:, 0]
        l = y[:, None, None] * H[:, 2] - H[:, 1]
        point = torch.linalg.cross(k, l)
        low_pass = DISK_LOW_PASS * (pixels[:, None] - projected_centres).square().sum(-1)
        # Decided before the division: a disk counts as missed where the low-pass would be the minimum anyway.
        hit = point[..., :2].square().sum(-1) < low_pass * point[..., 2].square()
        uv = point[..., :2] / torch.where(hit, point[..., 2], 1.0)[..., None]
        z = uv[..., 0] * H[:, 2, 0] + uv[..., 1] * H[:, 2, 1] + centre_z
        hit = hit & (z > near)
        distance = torch.where(hit, uv.square().sum(-1), low_pass)
        return 0.5 * distance, torch.where(hit, z, centre_z)

    return falloff


def _composite(
    layers: Layers, pixels: Float[Tensor, "p 2"], background: tuple[float, float, float]
) -> tuple[
    Float[Tensor, "p 3"], Float[Tensor, "p 1"], Float[Tensor, "p 1"], Float[Tensor, "p 1"], Float[Tensor, "p 3"]
]:
    """Blend front to back: colour, expected depth, alpha, median depth (no gradient) and normals."""
    power, z = layers.falloff(pixels)
    alpha = (layers.opacity * torch.exp(-power)).clamp_max(ALPHA_MAX)
    alpha = torch.where(alpha >= ALPHA_MIN, alpha, 0.0)
    transmittance_after = torch.cumprod(1 - alpha, -1)
    included = transmittance_after.detach() >= TRANSMITTANCE_MIN
    transmittance_before = torch.cat([torch.ones_like(transmittance_after[:, :1]), transmittance_after], -1)[:, :-1]
    weight = torch.where(included, alpha * transmittance_before, 0.0)
    total = weight.sum(-1, keepdim=True)
    colour = weight @ layers.colour + (1 - total) * weight.new_tensor(background)
    covered = total >= DEPTH_ALPHA_MIN
    depth = torch.where(covered, (weight * z).sum(-1, keepdim=True) / torch.where(covered, total, 1.0), 0.0)
    crosses_half = included & (transmittance_before > 0.5) & (transmittance_after <= 0.5)
    median = torch.where(crosses_half, z, 0.0).detach().sum(-1, keepdim=True)
    normals = torch.zeros_like(colour)
    if layers.normals is not None:
        normals = torch.where(covered, torch.nn.functional.normalize(weight @ layers.normals, dim=-1), 0.0)
    return colour, depth, total, median, normals


def rotations(quaternions: Float[Tensor, "n 4"]) -> Float[Tensor, "n 3 3"]:
    """Rotation matrices of quaternions (w, x, y, z) of any non-zero length."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=-1).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def sh_values(sh: Float[Tensor, "n k 3"], directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
    """Sum of real spherical harmonics of degree 0 to 3 times their coefficients, in the order and sign of 3DGS."""
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    a, b = SH_2, SH_3
    basis = [torch.full_like(x, SH_0), -SH_1 * y, SH_1 * z, -SH_1 * x]
    basis += [a[0] * x * y, a[1] * y * z, a[2] * (2 * zz - xx - yy), a[3] * x * z, a[4] * (xx - yy)]
    basis += [b[0] * y * (3 * xx - yy), b[1] * x * y * z, b[2] * y * (4 * zz - xx - yy)]
    basis += [b[3] * z * (2 * zz - 3 * xx - 3 * yy), b[4] * x * (4 * zz - xx - yy)]
    basis += [b[5] * z * (xx - yy), b[6] * x * (xx - 3 * yy)]
    return torch.einsum("nk,nkc->nc", torch.stack(basis[: sh.shape[1]], -1), sh)


def _pixel_centres(camera: Camera, like: Tensor) -> Float[Tensor, "p 2"]:
    """Centres of all pixels as (x, y), row by row."""
    y = torch.arange(camera.height, dtype=like.dtype, device=like.device) + 0.5
    x = torch.arange(camera.width, dtype=like.dtype, device=like.device) + 0.5
    return torch.stack(torch.meshgrid(y, x, indexing="ij")[::-1], -1).reshape(-1, 2)
