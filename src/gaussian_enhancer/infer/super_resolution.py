"""Limits to the change that super-resolution makes beyond the render's resolution.

Axes: b batch, r references, h height, w width, H and W multiples of them.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.network.pyramid import upsample_bicubic


def upsample_where_unseen(
    finer: Float[Tensor, "b 3 H W"], image: Float[Tensor, "b 3 h w"], visibility: Float[Tensor, "b r 1 h w"]
) -> Float[Tensor, "b 3 H W"]:
    """Replace a super-resolved image by the bicubically upsampled one where no reference is visible.

    There the finer scales have nothing to read, and can make patterns of their own.

    Args:
        finer: the super-resolved image, at a multiple of the image's size; it is changed in place.
        image: the image that was super-resolved.
        visibility: visibility of the references. Between visible pixels and others, the images are blended over 3x3
            pixels.
    """
    seen = (visibility > 0).any(1).to(image)
    if bool(seen.all()):
        return finer
    scale = finer.shape[-1] // image.shape[-1]
    share = F.avg_pool2d(seen, 3, stride=1, padding=1, count_include_pad=False)
    share = F.interpolate(share, scale_factor=scale, mode="bilinear", align_corners=False)
    for channel in range(3):  # one at a time, so that large images need little memory
        plane = finer[:, channel, None]
        torch.lerp(upsample_bicubic(image[:, channel, None], scale), plane, share, out=plane)
    return finer
