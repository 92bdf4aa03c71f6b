"""Photometric loss of a fit, (1 - weight) L1 + weight (1 - SSIM), with a hand-written gradient.

Axes: c channels, h height, w width. SSIM is the mean of `ssim_map` over channels and pixels.
float32 on the CPU uses the compiled kernels. Other devices and dtypes use plain PyTorch, which is also the reference
for the kernels.
"""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.ssim import filter_windowed, ssim_map
from gaussian_enhancer.types import Movable


@dataclass(frozen=True)
class PreparedPhoto(Movable):
    """A photo with the two filtered images that SSIM needs of it.

    Args:
        photo: the photo in [0, 1].
        mean: the photo filtered with SSIM's window.
        square: the squared photo filtered with SSIM's window.
    """

    photo: Float[Tensor, "c h w"]
    mean: Float[Tensor, "c h w"]
    square: Float[Tensor, "c h w"]


def prepare(photo: Float[Tensor, "c h w"]) -> PreparedPhoto:
    """Compute the parts of the loss that depend on the photo alone.

    Args:
        photo: image in [0, 1].
    """
    photo = photo.detach().contiguous()
    if not _similarity_compiled(photo):
        return PreparedPhoto(photo, filter_windowed(photo), filter_windowed(photo * photo))
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
    if _similarity_compiled(image):
        return _CompiledLoss.apply(image, target, weight)  # type: ignore[no-any-return]
    l1 = (image - target.photo).abs().mean()
    return (1 - weight) * l1 + weight * (1 - ssim_map(image, target.photo).mean())


class _CompiledLoss(torch.autograd.Function):
    """The loss through the compiled kernels; the gradient is computed in the backward pass only."""

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
        ssim, l1 = sums.sum(1, dtype=torch.float64) / image.numel()
        return ((1 - weight) * l1 + weight * (1 - ssim)).float()

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


def _similarity_compiled(image: Tensor) -> bool:
    return image.device.type == "cpu" and image.dtype == torch.float32
