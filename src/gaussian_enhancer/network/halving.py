"""Halving of an image's resolution, by pixel-unshuffle or by averaging, in few passes over memory.

Axes: b batch, c channels, h height, w width (both even), i = h / 2, j = w / 2.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

WORDS = {2: torch.int32, 4: torch.int64}
"""Integer types that hold two pixels, by the number of bytes of one pixel."""


def pixel_unshuffle(image: Float[Tensor, "b c h w"]) -> Float[Tensor, "b 4*c i j"]:
    """Pixel-unshuffle by 2: squares of 2x2 pixels become channels.

    Bit-identical to `torch.nn.functional.pixel_unshuffle`. On the CPU the result is in channels-last memory, the
    format of the following convolution, and two pixels are moved at a time.

    Args:
        image: image with even sides.
    """
    word = WORDS.get(image.element_size())
    use_torch = image.device.type != "cpu" or image.requires_grad or torch.compiler.is_compiling()
    if use_torch or word is None:
        return F.pixel_unshuffle(image, 2)
    batch, channels, height, width = image.shape
    if image.numel() == 0:
        return image.new_zeros(batch, 4 * channels, height // 2, width // 2)
    pairs = image.contiguous().view(word).view(batch, channels, height // 2, 2, width // 2)
    unshuffled_pairs = pairs.permute(0, 2, 4, 1, 3).contiguous().view(image.dtype)
    return unshuffled_pairs.view(batch, height // 2, width // 2, 4 * channels).permute(0, 3, 1, 2)


def halve(image: Float[Tensor, "*b h w"]) -> Float[Tensor, "*b i j"]:
    """Means over squares of 2x2 pixels; rows are added first, since they are contiguous in memory.

    Args:
        image: image with even sides.
    """
    rows = image[..., 0::2, :] + image[..., 1::2, :]
    return (rows[..., 0::2] + rows[..., 1::2]).mul_(0.25)
