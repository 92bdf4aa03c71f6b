"""Distance of two sets of images in their power spectra.

Axes: c channels, h height, w width, r rings of frequency.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError

ROUNDING = 1 / (12 * 255**2)
"""Power density of the rounding to 8 bits; a spectrum below it carries no information."""


def radial_spectrum(image: Float[Tensor, "c h w"], rings: int = 16) -> Float[Tensor, " r"]:
    """Power density in dB by spatial frequency, averaged over directions and channels.

    10 log10(mean |F(g v)|^2 / sum g^2 + 1 / (12 255^2)), where v is the image minus its mean and g a Hann window, which
    suppresses the jump between opposite edges. White noise of variance V has about 10 log10 V in every ring, at any
    image size.

    Args:
        image: an image, or a difference of two.
        rings: rings of equal width between 0 and 0.5 cycles per pixel.
    """
    height, width = image.shape[-2:]
    v = image.double() - image.double().mean(dim=(1, 2), keepdim=True)
    window = _hann(height, v)[:, None] * _hann(width, v)[None, :]
    power = torch.fft.fft2(window * v).abs().square().mean(dim=0) / window.square().sum()
    fy, fx = (torch.fft.fftfreq(side, device=v.device, dtype=v.dtype) for side in (height, width))
    frequency = torch.hypot(fy[:, None], fx[None, :]).flatten()
    inside = (frequency > 0) & (frequency < 0.5)
    ring = (frequency[inside] * 2 * rings).long()
    count = torch.bincount(ring, minlength=rings)
    if not bool(count.all()):
        raise InputError("image", f"is {width}x{height} pixels", f"ask for fewer than {rings} rings")
    total = torch.bincount(ring, weights=power.flatten()[inside], minlength=rings)
    return 10 * torch.log10(total / count + ROUNDING)


def spectrum_distance(first: Sequence[Float[Tensor, "c _ _"]], second: Sequence[Float[Tensor, "c _ _"]]) -> float:
    """Mean over rings of the absolute difference, in dB, of two sets' mean radial spectra.

    Args:
        first: images, of any sizes.
        second: other images, of any sizes.

    Returns:
        dB, 0 for sets of equal mean spectra.
    """
    means = [torch.stack([radial_spectrum(image) for image in images]).mean(dim=0) for images in (first, second)]
    return (means[0] - means[1]).abs().mean().item()


def _hann(side: int, like: Tensor) -> Float[Tensor, " side"]:
    """Hann window, positive at every pixel."""
    position = (torch.arange(side, device=like.device, dtype=like.dtype) + 0.5) / side
    return torch.sin(math.pi * position).square()
