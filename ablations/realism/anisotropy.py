"""Distance of two sets of images in the anisotropy of their gradients: needles and bands have one direction.

Axes: c channels, h height, w width, n pixels, k bins.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from kornia.filters import gaussian_blur2d, spatial_gradient
from torch import Tensor

QUIET = 1 / 255
"""Root mean square gradient, per pixel, below which a neighbourhood's direction is not determined."""
BINS = 64
"""Number of bins of the histograms of coherence."""


def coherence(image: Float[Tensor, "c h w"], sigma: float = 2.0) -> Float[Tensor, " n"]:
    """Coherence of the gradients around each pixel: (l1 - l2) / (l1 + l2) of the structure tensor's eigenvalues.

    It is 0 where gradients have no preferred direction and 1 where all are parallel. The tensor is summed over channels
    and averaged by a Gaussian. Neighbourhoods without gradients are left out, so n is at most h times w.

    Args:
        image: an image, or a difference of two.
        sigma: standard deviation of the neighbourhood, pixels.
    """
    gradient = spatial_gradient(image[None].float(), mode="diff")[0]
    x, y = gradient.unbind(dim=1)
    tensor = torch.stack([(x * x).sum(dim=0), (x * y).sum(dim=0), (y * y).sum(dim=0)])
    side = 2 * round(3 * sigma) + 1
    xx, xy, yy = gaussian_blur2d(tensor[None], (side, side), (sigma, sigma))[0].unbind(dim=0)
    energy = xx + yy
    lively = energy > image.shape[0] * QUIET**2
    directed = ((xx - yy).square() + 4 * xy.square()).sqrt()
    return (directed[lively] / energy[lively]).clamp(0, 1)


def coherence_histogram(images: Sequence[Float[Tensor, "c _ _"]]) -> Float[Tensor, " k"]:
    """Share of the pixels of all images in each of equal bins of coherence from 0 to 1; all zero without gradients."""
    count = torch.stack([torch.histc(coherence(image), BINS, 0, 1).double() for image in images]).sum(dim=0)
    return count / count.sum().clamp_min(1)


def anisotropy_distance(first: Sequence[Float[Tensor, "c _ _"]], second: Sequence[Float[Tensor, "c _ _"]]) -> float:
    """1-Wasserstein distance between two sets' distributions of coherence.

    The area between the cumulative histograms, in units of coherence: 0 for equal distributions, at most 1.

    Args:
        first: images, of any sizes.
        second: other images, of any sizes.
    """
    difference = coherence_histogram(first) - coherence_histogram(second)
    return (difference.cumsum(dim=0).abs().sum() / BINS).item()
