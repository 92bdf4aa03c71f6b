"""Image quality: PSNR, SSIM, colour-aligned PSNR and PSNR within a mask.

Axes: c channels, h height, w width, n pixels. Images are in [0, 1]. The fixed protocol first rounds them to the 8 bits
of a PNG (`types.quantise_8_bit`), since 3DGS's and NerfBaselines' evaluations read 8-bit files.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.ssim import ssim_map


def psnr(
    image: Float[Tensor, "c h w"], photo: Float[Tensor, "c h w"], mask: Float[Tensor, "1 h w"] | None = None
) -> float:
    """Peak signal-to-noise ratio in dB, -10 log10 of the mean squared error; infinite for equal images.

    Args:
        image: the image to measure, [0, 1].
        photo: the ground truth, [0, 1].
        mask: weight of each pixel in [0, 1], for the PSNR of an object in front of an empty background.

    Returns:
        PSNR in dB; NaN if the mask is empty.
    """
    error = (image.double() - photo.double()).square()
    if mask is None:
        mean = error.mean().item()
    else:
        weight = mask.double().sum().item() * image.shape[0]
        mean = (error * mask.double()).sum().item() / weight if weight > 0 else math.nan
    return math.inf if mean == 0 else -10 * math.log10(mean)


def ssim(image: Float[Tensor, "c h w"], photo: Float[Tensor, "c h w"]) -> float:
    """Structural similarity, mean over channels and pixels, computed as in 3DGS's evaluation (`ssim_map`).

    Args:
        image: the image to measure, [0, 1].
        photo: the ground truth, [0, 1].
    """
    return ssim_map(image.double(), photo.double()).mean().item()


def align_colours(image: Float[Tensor, "3 h w"], photo: Float[Tensor, "3 h w"]) -> Float[Tensor, "3 h w"]:
    """Apply the affine colour map (3x4, least squares over all pixels) that brings the image closest to the photo.

    This removes exposure and white balance, which differ from photo to photo, from a comparison. The mean squared error
    never increases, since the identity is such a map. The result is not clamped.

    Args:
        image: the image to measure, [0, 1].
        photo: the ground truth, [0, 1].
    """
    colours = image.double().flatten(1)
    mapping = fit_colour_map(colours, photo.double().flatten(1))
    return (mapping[:, :3] @ colours + mapping[:, 3:]).view(image.shape).to(image.dtype)


def fit_colour_map(colours: Float[Tensor, "3 n"], target_colours: Float[Tensor, "3 n"]) -> Float[Tensor, "3 4"]:
    """Fit an affine map, a matrix and an offset, from colours to target colours by least squares.

    Args:
        colours: colours of n pixels.
        target_colours: colours that the map should give these pixels.
    """
    colours = torch.cat([colours, torch.ones_like(colours[:1])])
    # For grey pixels the system is rank-deficient: the pseudo-inverse gives the minimum-norm solution.
    return target_colours @ colours.T @ torch.linalg.pinv(colours @ colours.T, hermitian=True, rtol=1e-12)


def psnr_aligned(image: Float[Tensor, "3 h w"], photo: Float[Tensor, "3 h w"]) -> float:
    """PSNR in dB after the best affine colour map from image to photo; infinite for equal images."""
    if torch.equal(image, photo):
        return math.inf  # a fitted identity map has rounding errors
    return psnr(align_colours(image.double(), photo.double()), photo)
