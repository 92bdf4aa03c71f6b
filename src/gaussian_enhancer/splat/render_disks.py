"""2DGS on the CPU: the compiled kernels as one differentiable function of the Gaussians' tensors.

Axes: n Gaussians, h height, w width.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from gaussian_enhancer.splat import disks, ewa, raster_disks, tiles
from gaussian_enhancer.splat import sh as harmonics
from gaussian_enhancer.splat.screen import ScreenStatistics
from gaussian_enhancer.types import Camera, Gaussians, Render, numpy_view


def render_disks(
    gaussians: Gaussians,
    camera: Camera,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    near: float = 0.01,
    screen: ScreenStatistics | None = None,
) -> Render:
    """Render disks by ray-splat intersection; see `splat.render.render`, which calls this.

    Args:
        gaussians: float32 on the CPU, two scale axes.
        camera: on any device.
        background: colour behind everything, [0, 1].
        near: smallest z in scene units that is drawn, of centres and of intersections.
        screen: filled with statistics for densification, if given.
    """
    planes = _Disks.apply(
        gaussians.means,
        gaussians.log_scales,
        gaussians.quaternions,
        gaussians.opacity_logits,
        gaussians.sh,
        (camera, background, near, screen),
    )
    return Render(*planes)


class _Disks(torch.autograd.Function):
    """Forward and analytic backward; the median depth carries no gradient."""

    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        log_scales: Tensor,
        quaternions: Tensor,
        opacity_logits: Tensor,
        sh: Tensor,
        options: tuple[Camera, tuple[float, float, float], float, ScreenStatistics | None],
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        camera, background, near, screen = options
        no_smoothing = np.zeros(len(means), np.float32)
        shape = ewa.Shape(
            numpy_view(means), numpy_view(log_scales), numpy_view(quaternions), numpy_view(opacity_logits), no_smoothing
        )
        view = ewa.view_of(camera, near)
        projected = disks.project_disks(shape, view)
        lists = tiles.bin_tiles(projected.footprints, projected.depths, camera.height, camera.width)
        visible = lists.visible
        colours = harmonics.shade(shape.means, numpy_view(sh), view.centre, visible)
        splats = raster_disks.DiskSplats(
            projected.geometry, projected.peaks, projected.depths, projected.normals, colours, float(near)
        )
        background_colour = np.asarray(background, np.float32)
        image = raster_disks.blend_disks(splats, lists, background_colour, camera.height, camera.width)
        if screen is not None:
            screen.visible = torch.from_numpy(visible)
            screen.gradient = None
        ctx.saved = shape, numpy_view(sh), view, visible, splats, lists, image, screen
        median = torch.from_numpy(image.median_depth)
        ctx.mark_non_differentiable(median)
        colour, depth, alpha = (torch.from_numpy(plane) for plane in image[:3])
        return colour, depth, alpha, median, torch.from_numpy(image.normals)

    @staticmethod
    @once_differentiable  # type: ignore[untyped-decorator]
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        shape, sh, view, visible, splats, lists, image, screen = ctx.saved
        colour, depth, alpha, _, normals = (numpy_view(gradient) for gradient in gradients)
        entry_gradients = raster_disks.blend_disks_backward(splats, lists, image, colour, depth, alpha, normals)
        gaussian_gradients = tiles.sum_over_tiles(entry_gradients, lists)
        parameter_gradients = disks.project_disks_backward(shape, view, visible, gaussian_gradients)
        colour_gradient = np.ascontiguousarray(gaussian_gradients[:, :3])
        sh_gradient = harmonics.shade_backward(
            shape.means, sh, view.centre, visible, splats.colours, colour_gradient, parameter_gradients.means
        )
        if screen is not None:
            screen.gradient = torch.from_numpy(np.linalg.norm(gaussian_gradients[:, 3:5], axis=1))
        input_gradients = (
            parameter_gradients.means,
            parameter_gradients.log_scales,
            parameter_gradients.quaternions,
            parameter_gradients.opacity_logits,
            sh_gradient,
        )
        return *(torch.from_numpy(gradient) for gradient in input_gradients), None
