"""Structural similarity (SSIM) for fitting, training and measurement, with the details of 3DGS's evaluation.

Gaussian window of 11x11 pixels and sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2. Source: Wang et al., Image
Quality Assessment, TIP 2004, equation 13; padding as in Kerbl et al., SIGGRAPH 2023. Axes: h height, w width.
"""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

C1 = 0.01**2
C2 = 0.03**2
RADIUS = 5
"""Radius of the window in pixels."""
SIGMA = 1.5


def window_weights(distance: Tensor) -> Tensor:
    """Weights of the window along one axis, at integer distances in pixels from its centre; all eleven sum to one."""
    offsets = torch.arange(-RADIUS, RADIUS + 1, dtype=distance.dtype, device=distance.device)
    total = torch.exp(-offsets.square() / (2 * SIGMA**2)).sum()
    return torch.exp(-distance.square() / (2 * SIGMA**2)) * (distance.abs() <= RADIUS) / total


def filter_windowed(images: Float[Tensor, "*n h w"]) -> Float[Tensor, "*n h w"]:
    """Filter images with the window, with zero padding.

    Args:
        images: any number of planes.
    """
    window = window_weights(torch.arange(-RADIUS, RADIUS + 1, dtype=images.dtype, device=images.device))
    planes = images.reshape(-1, 1, *images.shape[-2:])
    rows = functional.conv2d(planes, window[None, None, :, None], padding=(RADIUS, 0))
    return functional.conv2d(rows, window[None, None, None, :], padding=(0, RADIUS)).view(images.shape)


def ssim_map(
    x: Float[Tensor, "*n h w"], y: Float[Tensor, "*n h w"], filter_images: Callable[[Tensor], Tensor] = filter_windowed
) -> Float[Tensor, "*n h w"]:
    """Structural similarity of every pixel and channel.

    Args:
        x: first image, [0, 1].
        y: second image, [0, 1].
        filter_images: filters images with the window; a caller may pass another implementation of the same filter.
    """
    mean_x, mean_y, square_x, square_y, product = filter_images(torch.stack([x, y, x * x, y * y, x * y]))
    luminance = (2 * mean_x * mean_y + C1) / (mean_x.square() + mean_y.square() + C1)
    spread = square_x - mean_x.square() + square_y - mean_y.square()
    return luminance * (2 * (product - mean_x * mean_y) + C2) / (spread + C2)
