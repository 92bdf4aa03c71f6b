"""Measurement of all metrics of the fixed protocol for one image and its photo.

Axes: h height, w width.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.image_quality import psnr, psnr_aligned, ssim
from gaussian_enhancer.metrics.lpips import PerceptualDistance
from gaussian_enhancer.types import quantise_8_bit

PROTOCOL = (
    "8-bit images; PSNR over all channels; psnr_aligned after the best affine colour map; psnr_masked over the mask; "
    "SSIM 11x11 sigma 1.5 zero padding; LPIPS v0.1"
)
"""The protocol that every quality record states."""


@dataclass(frozen=True)
class ImageMetrics:
    """Metrics of one image.

    Args:
        metrics: value by name; None if it could not be measured.
        reasons: the reason for each None, by the same names.
    """

    metrics: dict[str, float | None]
    reasons: dict[str, str]


def measure_pair(
    image: Float[Tensor, "3 h w"],
    photo: Float[Tensor, "3 _ _"],
    distances: Sequence[PerceptualDistance] = (),
    mask: Float[Tensor, "1 _ _"] | None = None,
) -> ImageMetrics:
    """Measure an image against its photo; both are first quantised to 8 bits.

    Args:
        image: the image to measure, [0, 1].
        photo: the ground truth, [0, 1], of the same size.
        distances: LPIPS distances to measure as well.
        mask: coverage of the object in [0, 1], for ``psnr_masked``.

    Raises:
        InputError: the sizes differ.
    """
    for name, plane in (("photo", photo), ("mask", mask)):
        if plane is not None and plane.shape[1:] != image.shape[1:]:
            received = f"is {plane.shape[2]}x{plane.shape[1]} where the image is {image.shape[2]}x{image.shape[1]}"
            raise InputError(name, received, "bring both to one size")
    image, photo = quantise_8_bit(image), quantise_8_bit(photo)
    metrics: dict[str, float | None] = {
        "psnr": psnr(image, photo),
        "psnr_aligned": psnr_aligned(image, photo),
        "ssim": ssim(image, photo),
    }
    reasons = {}
    if mask is not None:
        metrics["psnr_masked"] = psnr(image, photo, mask)
        if math.isnan(metrics["psnr_masked"] or 0.0):
            metrics["psnr_masked"] = None
            reasons["psnr_masked"] = "not measured: the mask is empty"
    for distance in distances:
        reason = distance.size_reason(image.shape[1], image.shape[2])
        metrics[distance.name] = None if reason else distance.between(image, photo)
        if reason:
            reasons[distance.name] = reason
    return ImageMetrics(metrics, reasons)
