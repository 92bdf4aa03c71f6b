"""Rendering on CUDA through the gsplat library (1.5 or newer), with the same contract as the CPU kernels.

Axes: n Gaussians, h height, w width. Where gsplat differs from `splat.oracle`:
    - disks: depths are the z of the centres, not of the intersections; alpha is capped at 0.999 instead of 0.99
      before version 1.6; the low-pass is centred on the bounding box of the projected disk; intersections are not
      clipped at the near plane;
    - Mip-Splatting: from version 1.6 the factor on opacity is at least 0.005.
"""

import math
from typing import Any

import torch
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.optional_library import optional_library
from gaussian_enhancer.splat.filters import apply_3d_filter
from gaussian_enhancer.splat.methods import Method, MipSplatting, TwoDGS
from gaussian_enhancer.splat.oracle import DEPTH_ALPHA_MIN
from gaussian_enhancer.splat.screen import ScreenStatistics
from gaussian_enhancer.types import Camera, Gaussians, Render


def render_gsplat(
    gaussians: Gaussians,
    camera: Camera,
    method: Method,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    near: float = 0.01,
    screen: ScreenStatistics | None = None,
) -> Render:
    """Render one view with gsplat; see `splat.render.render`, which calls this.

    Args:
        gaussians: float32; three scale axes for ellipsoids, two for disks.
        camera: on any device; it is moved to the device of the Gaussians.
        method: 3DGS, 2DGS or Mip-Splatting, which determines the footprints.
        background: colour behind everything, [0, 1].
        near: smallest z in scene units that is drawn.
        screen: filled with statistics for densification, if given.

    Raises:
        InputError: if gsplat cannot be imported or the Gaussians are not float32.
    """
    if gaussians.means.dtype != torch.float32:
        raise InputError("splat", f"has dtype {gaussians.means.dtype}", "use float32 on CUDA")
    gsplat = optional_library("gsplat", "rendering on CUDA", "cuda")
    arguments = _arguments(gaussians, camera, method, near)
    median = normals = None
    if isinstance(method, TwoDGS):
        planes, alphas, world_normals, _, _, medians, meta = gsplat.rasterization_2dgs(**arguments)
        # gsplat returns normals in world axes, and a median depth even where alpha is below one half.
        median = torch.where(alphas[0] >= 0.5, medians[0], 0.0).detach()
        unit = torch.nn.functional.normalize(world_normals[0] @ camera.rotation.to(planes).T, dim=-1)
        normals = torch.where(alphas[0] >= DEPTH_ALPHA_MIN, unit, 0.0)
    else:
        mode = "antialiased" if isinstance(method, MipSplatting) else "classic"
        arguments |= {"eps2d": method.dilation, "rasterize_mode": mode}
        planes, alphas, meta = gsplat.rasterization(**arguments)
    if screen is not None:
        _record_statistics(screen, meta, planes, isinstance(method, TwoDGS))
    colour = planes[0, ..., :3] + (1 - alphas[0]) * planes.new_tensor(background)
    depth = torch.where(alphas[0] >= DEPTH_ALPHA_MIN, planes[0, ..., 3:], 0.0)
    images = (colour, depth, alphas[0], median, normals)
    return Render(*(None if image is None else image.permute(2, 0, 1) for image in images))  # type: ignore[arg-type]


def _arguments(gaussians: Gaussians, camera: Camera, method: Method, near: float) -> dict[str, Any]:
    """Arguments that both rasterisers of gsplat take, with one camera as a batch."""
    scales, opacities = torch.exp(gaussians.log_scales), torch.sigmoid(gaussians.opacity_logits)
    if isinstance(method, TwoDGS):
        scales = torch.cat([scales, torch.ones_like(scales[:, :1])], 1)
    elif isinstance(method, MipSplatting) and gaussians.smoothing is not None:
        scales, opacities = apply_3d_filter(scales, opacities, gaussians.smoothing)
    return {
        "means": gaussians.means,
        "quats": gaussians.quaternions,
        "scales": scales,
        "opacities": opacities,
        "colors": gaussians.sh,
        "sh_degree": math.isqrt(gaussians.sh.shape[1]) - 1,
        "viewmats": camera.world_to_camera.to(gaussians.means)[None].contiguous(),
        "Ks": camera.K.to(gaussians.means)[None].contiguous(),
        "width": camera.width,
        "height": camera.height,
        "near_plane": near,
        "render_mode": "RGB+ED",
        "packed": False,
    }


def _record_statistics(screen: ScreenStatistics, meta: dict[str, Any], planes: Tensor, disks: bool) -> None:
    """Set the visibility now, and register a hook by which the backward sets the gradients."""
    screen.visible = (meta["radii"][0] > 0).all(-1)
    screen.gradient = None
    projected_means = meta["gradient_2dgs" if disks else "means2d"]
    if not (projected_means.requires_grad and planes.grad_fn):
        return

    def record_gradient(gradient: Tensor) -> None:
        screen.gradient = gradient[0].norm(dim=-1)

    projected_means.register_hook(record_gradient)
