"""How far a render is from its photo while fitting: (1 - weight) L1 + weight (1 - SSIM), with a gradient of its own.

Axes: c channels, h height, w width. SSIM as 3DGS measures it: 11x11 Gaussian window of sigma 1.5, zero padding,
C1 = 0.01^2, C2 = 0.03^2 (Wang et al., Image Quality Assessment, TIP 2004, equation 13), mean over channels and pixels.
float32 on the CPU takes the compiled kernels; every other device or type takes plain torch, which is also their oracle.
"""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from gaussian_enhancer.types import Movable

C1 = 0.01**2
C2 = 0.03**2


@dataclass(frozen=True)
class PreparedPhoto(Movable):
    """A photo with the two filtered images that SSIM needs of it.

    Args:
        photo: the photo in [0, 1].
        mean: the photo under the window.
        square: the squared photo under the window.
    """

    photo: Float[Tensor, "c h w"]
    mean: Float[Tensor, "c h w"]
    square: Float[Tensor, "c h w"]


def prepare(photo: Float[Tensor, "c h w"]) -> PreparedPhoto:
    """Compute once what does not change while the render does.

    Args:
        photo: image in [0, 1].
    """
    photo = photo.detach().contiguous()
    if not _compiled(photo):
        return PreparedPhoto(photo, _filtered(photo), _filtered(photo * photo))
    from gaussian_enhancer.splat.fit import similarity_kernels as kernels

    mean, square = torch.empty_like(photo), torch.empty_like(photo)
    kernels.photo_statistics(photo.numpy(), kernels.gaussian_window(), mean.numpy(), square.numpy())
    return PreparedPhoto(photo, mean, square)


def photometric_loss(image: Float[Tensor, "c h w"], target: PreparedPhoto, weight: float = 0.2) -> Float[Tensor, ""]:
    """(1 - weight) mean |image - photo| + weight (1 - mean SSIM), differentiable in the image.

    Source: Kerbl et al., 3D Gaussian Splatting, SIGGRAPH 2023, equation 7.

    Args:
        image: render, not necessarily within [0, 1].
        target: prepared photo of the same size.
        weight: share of the SSIM term, in [0, 1].
    """
    if _compiled(image):
        return _CompiledLoss.apply(image, target, weight)  # type: ignore[no-any-return]
    absolute = (image - target.photo).abs().mean()
    return (1 - weight) * absolute + weight * (1 - ssim_map(image, target.photo).mean())


def ssim_map(image: Float[Tensor, "c h w"], photo: Float[Tensor, "c h w"]) -> Float[Tensor, "c h w"]:
    """Structural similarity of every pixel and channel in plain torch: (a b) / (p q) of the local moments.

    Args:
        image: first image.
        photo: second image.
    """
    mean_x, mean_y = _filtered(image), _filtered(photo)
    variance_x = _filtered(image * image) - mean_x**2
    variance_y = _filtered(photo * photo) - mean_y**2
    covariance = _filtered(image * photo) - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    return luminance * (2 * covariance + C2) / (variance_x + variance_y + C2)


class _CompiledLoss(torch.autograd.Function):
    """The loss through the compiled kernels; the gradient is made in the backward pass only."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, target: PreparedPhoto, weight: float) -> Tensor:
        from gaussian_enhancer.splat.fit import similarity_kernels as kernels

        image = image.detach().contiguous()
        partial = torch.empty((3, *image.shape))
        sums = torch.empty(2, image.shape[0] * image.shape[1])
        kernels.similarity_forward(
            image.numpy(),
            target.photo.numpy(),
            target.mean.numpy(),
            target.square.numpy(),
            kernels.gaussian_window(),
            partial.numpy(),
            sums[0].numpy(),
            sums[1].numpy(),
        )
        ctx.image, ctx.target, ctx.partial, ctx.weight = image, target, partial, weight
        ssim, absolute = sums.sum(1, dtype=torch.float64) / image.numel()
        return ((1 - weight) * absolute + weight * (1 - ssim)).float()

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor, None, None]:
        from gaussian_enhancer.splat.fit import similarity_kernels as kernels

        gradient = torch.empty_like(ctx.image)
        scale = float(upstream[0]) / ctx.image.numel()
        kernels.similarity_backward(
            ctx.image.numpy(),
            ctx.target.photo.numpy(),
            ctx.partial.numpy(),
            kernels.gaussian_window(),
            -ctx.weight * scale,
            (1 - ctx.weight) * scale,
            gradient.numpy(),
        )
        return gradient, None, None


def _compiled(image: Tensor) -> bool:
    return image.device.type == "cpu" and image.dtype == torch.float32


def _filtered(image: Tensor) -> Tensor:
    offsets = torch.arange(-5, 6, dtype=image.dtype, device=image.device)
    window = torch.exp(-(offsets**2) / (2 * 1.5**2))
    window = (window / window.sum()).reshape(1, 1, 11, 1)
    rows = functional.conv2d(image[:, None], window, padding=(5, 0))
    return functional.conv2d(rows, window.transpose(2, 3), padding=(0, 5))[:, 0]
