"""Colour matching of references to the render, since photos of a capture differ in exposure and white balance.

Axes: h height, w width.
"""

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.projection import can_use_kernels
from gaussian_enhancer.types import numpy_view, single_precision

LEAST_MASS = 1e-3
"""Sum of the blocks' visibilities below which colours are not fitted; then the gain is 1 and the offset 0."""
ROBUSTNESS = 0.05
"""Residual, in colour units, at which a pixel's weight falls to 1/4."""
ITERATIONS = 3
"""Number of reweightings."""


def fit_colour(
    source: Float[Tensor, "3 h w"],
    target: Float[Tensor, "3 h w"],
    weight: Float[Tensor, "1 h w"],
    prior: float = 0.02,
) -> Float[Tensor, "3 2"]:
    """Least-squares gain and offset per channel from one image to another.

    Minimises sum_i w_i rho(g s_i + o - t_i) + prior sum_i w_i ((g - 1)^2 / 4 + o^2) by iteratively reweighted least
    squares with Geman-McClure weights, 1 / (1 + (r / 0.05)^2)^2, so that misaligned and occluded pixels have
    little influence. Images are averaged over 4x4 blocks first, which tolerates small misalignment.

    Args:
        source: the reference's colours, [0, 1].
        target: the render's colours, [0, 1].
        weight: visibility in [0, 1]; if it is zero everywhere, the gain is 1 and the offset 0.
        prior: weight of the regularisation towards the identity, relative to the data.

    Returns:
        Gain and offset of each channel; gains lie in [1/3, 3].
    """
    step = min(4, *source.shape[-2:])
    if can_use_kernels(source, target, weight):
        return _fit_compiled(source, target, weight, step, prior)
    mass = F.avg_pool2d(single_precision(weight), step).flatten(1).double()
    averaged = (F.avg_pool2d(single_precision(image) * weight, step).flatten(1).double() for image in (source, target))
    s, t = (image / mass.clamp_min(1e-6) for image in averaged)
    gain, offset = mass.new_ones(3, 1), mass.new_zeros(3, 1)
    if float(mass.sum()) < LEAST_MASS:
        return torch.cat([gain, offset], dim=1)
    for _ in range(ITERATIONS):
        residual = gain * s + offset - t
        w = mass / (1 + (residual / ROBUSTNESS) ** 2) ** 2
        prior_weight = prior * mass.sum()
        a, b, c = (w * s * s).sum(1) + prior_weight / 4, (w * s).sum(1), w.sum(1) + prior_weight
        u, v = (w * s * t).sum(1) + prior_weight / 4, (w * t).sum(1)
        determinant = (a * c - b * b).clamp_min(1e-12)
        gain = ((u * c - v * b) / determinant).clamp(1 / 3, 3)[:, None]
        offset = ((v - gain[:, 0] * b) / c)[:, None]
    return torch.cat([gain, offset], dim=1)


def _fit_compiled(
    source: Float[Tensor, "3 h w"],
    target: Float[Tensor, "3 h w"],
    weight: Float[Tensor, "1 h w"],
    step: int,
    prior: float,
) -> Float[Tensor, "3 2"]:
    """Compiled version of `fit_colour`."""
    from gaussian_enhancer.align.exposure_kernels import block_means, fit_channels
    from gaussian_enhancer.compiled import kernel_lock

    blocks = (source.shape[-2] // step) * (source.shape[-1] // step)
    mass, means = np.empty(blocks, np.float32), np.empty((2, 3, blocks), np.float32)
    result = torch.tensor([[1.0, 0.0]], dtype=torch.float64).repeat(3, 1)
    with kernel_lock:
        block_means(numpy_view(source), numpy_view(target), numpy_view(weight[0]), step, mass, means)
        if float(mass.sum(dtype=np.float64)) >= LEAST_MASS:
            fit_channels(mass, means, ROBUSTNESS, prior, ITERATIONS, result.numpy())
    return result


def fit_exposure(photo: Float[Tensor, "3 h w"], render: Float[Tensor, "3 h w"]) -> Float[Tensor, "3 2"]:
    """Gain and offset per channel from a photo to the splat's render of the same view, over the whole frame.

    Args:
        photo: colours in [0, 1].
        render: render from the photo's camera.

    Returns:
        See `fit_colour`.
    """
    return fit_colour(photo, render, torch.ones_like(photo[:1]))


def apply_colour(image: Float[Tensor, "3 h w"], transform: Float[Tensor, "3 2"]) -> Float[Tensor, "3 h w"]:
    """Apply gain and offset per channel and clamp the result to [0, 1].

    Args:
        image: colours in [0, 1].
        transform: gain and offset of each channel, from `fit_colour`.
    """
    transform = transform.to(image.dtype)
    return (image * transform[:, :1, None]).add_(transform[:, 1:, None]).clamp_(0, 1)


def match_exposure(photo: Float[Tensor, "3 h w"], render: Float[Tensor, "3 h w"]) -> Float[Tensor, "3 h w"]:
    """A photo with the exposure of the render of its view (`fit_exposure`)."""
    return apply_colour(photo, fit_exposure(photo, render))
