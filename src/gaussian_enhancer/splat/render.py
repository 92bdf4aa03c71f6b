"""Differentiable rendering of Gaussians from a camera, by one function with three backends.

Axes: n Gaussians, k spherical-harmonics coefficients, s scale axes, h height, w width.
"""

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.io.validity import hide_unrenderable
from gaussian_enhancer.splat.methods import Method, MipSplatting, ThreeDGS, TwoDGS, check_axes
from gaussian_enhancer.splat.screen import ScreenStatistics
from gaussian_enhancer.types import Camera, Gaussians, Render, numpy_view

if TYPE_CHECKING:
    from gaussian_enhancer.splat import ewa, raster, tiles


def render(
    gaussians: Gaussians,
    camera: Camera,
    method: Method,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    near: float = 0.01,
    screen: ScreenStatistics | None = None,
) -> Render:
    """Render one view, differentiably in the Gaussians' tensors (``smoothing`` excepted).

    On the CPU, float32 uses the compiled kernels and float64 the reference implementation in plain PyTorch
    (`splat.oracle`). CUDA uses gsplat. Half precision is too coarse for pixel positions: float16 and bfloat16 are
    computed in float32, and the image is float32.

    Gaussians with values that are not finite, or beyond `splat.io.validity.LIMITS`, are invisible and get gradients
    of 0.

    Args:
        gaussians: the splat; three scale axes for ellipsoids, two for disks.
        camera: on any device; its height and width are those of the image.
        method: 3DGS, 2DGS or Mip-Splatting, which determines the footprints.
        background: colour behind everything, [0, 1].
        near: smallest z in scene units that is drawn.
        screen: filled with statistics for densification, if given.

    Raises:
        InputError: if the number of scale axes does not match the method, or the camera or dtype cannot be used; in the
            backward pass, if a gradient exceeds the range of the splat's dtype.
    """
    if gaussians.means.dtype in (torch.float16, torch.bfloat16):
        gaussians = _to_float32(gaussians)
    _check(gaussians, camera, method, near, screen)
    gaussians = hide_unrenderable(gaussians)
    if gaussians.means.device.type == "cuda":
        from gaussian_enhancer.splat.gsplat_backend import render_gsplat

        return render_gsplat(gaussians, camera, method, background, near=near, screen=screen)
    if gaussians.means.dtype != torch.float32:
        from gaussian_enhancer.splat.oracle import render_oracle

        return render_oracle(gaussians, camera.to(gaussians.means.dtype), method, background, near=near)
    if isinstance(method, TwoDGS):
        from gaussian_enhancer.splat.render_disks import render_disks

        return render_disks(gaussians, camera, background, near=near, screen=screen)
    return _render_ellipsoids(gaussians, camera, method, background, near, screen)


def _to_float32(gaussians: Gaussians) -> Gaussians:
    """Convert a half-precision splat to float32; a gradient beyond the range of half precision raises an error."""
    converted, largest = gaussians.to(torch.float32), torch.finfo(gaussians.means.dtype).max
    for name, value in converted.tensors().items():
        if value is not None and value.requires_grad:
            value.register_hook(partial(_check_gradient_range, name, str(gaussians.means.dtype), largest))
    return converted


def _check_gradient_range(name: str, dtype: str, largest: float, gradient: Tensor) -> None:
    if float(gradient.abs().max()) > largest:
        raise InputError(f"gradient of the splat's {name}", f"is larger than {dtype} holds", "fit in float32")


def _check(gaussians: Gaussians, camera: Camera, method: Method, near: float, screen: ScreenStatistics | None) -> None:
    check_axes(gaussians, method)
    if gaussians.sh.shape[1] not in (1, 4, 9, 16):
        received = f"has {gaussians.sh.shape[1]} spherical-harmonics coefficients"
        raise InputError("splat", received, "use 1, 4, 9 or 16 (degrees 0 to 3)")
    if camera.height < 1 or camera.width < 1:
        raise InputError("camera", f"has an image of {camera.width}x{camera.height}", "use at least one pixel")
    if not near >= 0.0:
        raise InputError("near", f"is {near}", "use a distance that is not negative")
    if screen is not None and gaussians.means.device.type == "cpu" and gaussians.means.dtype != torch.float32:
        raise InputError("screen statistics", f"requested for {gaussians.means.dtype}", "render in float32")


def _render_ellipsoids(
    gaussians: Gaussians,
    camera: Camera,
    method: ThreeDGS | MipSplatting,
    background: tuple[float, float, float],
    near: float,
    screen: ScreenStatistics | None,
) -> Render:
    planes = _Ellipsoids.apply(
        gaussians.means,
        gaussians.log_scales,
        gaussians.quaternions,
        gaussians.opacity_logits,
        gaussians.sh,
        gaussians.smoothing,
        (camera, method, background, near, screen),
    )
    return Render(*planes)


class _SavedForBackward(NamedTuple):
    """Values that the forward stores for the backward, besides the tensors that autograd tracks."""

    view: "ewa.View"
    dilation: float
    mip: bool
    smoothing: np.ndarray
    visible: np.ndarray
    splats: "raster.Splats"
    lists: "tiles.TileLists"
    median_depth: np.ndarray
    blended_counts: np.ndarray
    screen: ScreenStatistics | None


class _Ellipsoids(torch.autograd.Function):
    """3DGS and Mip-Splatting on the CPU."""

    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        log_scales: Tensor,
        quaternions: Tensor,
        opacity_logits: Tensor,
        sh: Tensor,
        smoothing: Tensor | None,
        options: tuple[Camera, ThreeDGS | MipSplatting, tuple[float, float, float], float, ScreenStatistics | None],
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        from gaussian_enhancer.splat import ewa, raster, tiles
        from gaussian_enhancer.splat import sh as harmonics

        camera, method, background, near, screen = options
        filter_sizes = np.zeros(len(means), np.float32) if smoothing is None else numpy_view(smoothing)
        shape = ewa.Shape(
            numpy_view(means), numpy_view(log_scales), numpy_view(quaternions), numpy_view(opacity_logits), filter_sizes
        )
        view, dilation, mip = ewa.view_of(camera, near), float(method.dilation), isinstance(method, MipSplatting)
        projection = ewa.project(shape, view, dilation, mip)
        lists = tiles.bin_tiles(projection.footprints, projection.depths, camera.height, camera.width)
        visible = lists.visible
        colours = harmonics.shade(shape.means, numpy_view(sh), view.centre, visible)
        splats = raster.Splats(projection.footprints, projection.whitening, projection.depths, colours)
        image = raster.blend(splats, lists, np.asarray(background, np.float32), camera.height, camera.width)
        if screen is not None:
            screen.visible = torch.from_numpy(visible)
            screen.gradient = None
        colour, depth, alpha, median = (torch.from_numpy(plane) for plane in image[:4])
        ctx.save_for_backward(means, log_scales, quaternions, opacity_logits, sh, colour, depth, alpha)
        ctx.saved = _SavedForBackward(
            view, dilation, mip, filter_sizes, visible, splats, lists, image.median_depth, image.blended_counts, screen
        )
        ctx.mark_non_differentiable(median)
        return colour, depth, alpha, median

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        from gaussian_enhancer.splat import ewa, ewa_backward, raster, tiles
        from gaussian_enhancer.splat import sh as harmonics

        saved: _SavedForBackward = ctx.saved
        means, log_scales, quaternions, opacity_logits, sh, colour, depth, alpha = map(numpy_view, ctx.saved_tensors)
        shape = ewa.Shape(means, log_scales, quaternions, opacity_logits, saved.smoothing)
        image = raster.Image(colour, depth, alpha, saved.median_depth, saved.blended_counts)
        entry_gradients = raster.blend_backward(saved.splats, saved.lists, image, *map(numpy_view, gradients[:3]))
        gaussian_gradients = tiles.sum_over_tiles(entry_gradients, saved.lists)
        parameter_gradients = ewa_backward.project_backward(
            shape, saved.view, saved.dilation, saved.mip, saved.visible, gaussian_gradients
        )
        sh_gradient = harmonics.shade_backward(
            means,
            sh,
            saved.view.centre,
            saved.visible,
            saved.splats.colours,
            gaussian_gradients,
            parameter_gradients.means,
        )
        if saved.screen is not None:
            mean_gradients = ewa_backward.screen_gradients(saved.splats.whitening, gaussian_gradients)
            saved.screen.gradient = torch.from_numpy(np.linalg.norm(mean_gradients, axis=1))
        return *map(torch.from_numpy, (*parameter_gradients, sh_gradient)), None, None
