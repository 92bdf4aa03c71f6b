"""Encoder from images to features at half resolution.

Axes: b batch, c channels, h height, w width (both even), i = h / 2, j = w / 2.
"""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.bfloat16 import can_fuse, empty_features, kernel_lock, kernel_words, plane
from gaussian_enhancer.network.block import Block
from gaussian_enhancer.network.halving import pixel_unshuffle

COLOURS = -1.0, 2.0
"""Range to which the colours of references are clamped before they are encoded; images are within [0, 1]."""


class Encoder(nn.Module):
    """F[image]: a pixel-unshuffle by 2, which loses no detail, a convolution and residual blocks.

    Args:
        channels: number of feature channels.
        blocks: number of residual blocks.
        planes: number of input channels: colours, mask and further planes.
    """

    def __init__(self, channels: int, blocks: int = 1, planes: int = 4) -> None:
        super().__init__()
        self.channels = channels
        self.stem = nn.Conv2d(4 * planes, channels, 3, padding=1)
        self.blocks = nn.Sequential(*(Block(channels) for _ in range(blocks)))

    def forward(
        self,
        image: Float[Tensor, "b 3 h w"],
        mask: Float[Tensor, "b 1 h w"],
        extra_planes: Float[Tensor, "b _ h w"] | None = None,
    ) -> Float[Tensor, "b c i j"]:
        """Encode an image with the weight of each pixel.

        Args:
            image: colours in [0, 1].
            mask: opacity of a render or visibility of a reference, in [0, 1].
            extra_planes: additional planes of the image.
        """
        if extra_planes is None and can_fuse(image, mask):
            return self.features(pack_input(image, mask, -0.5))
        planes = [image - 0.5, mask] + ([] if extra_planes is None else [extra_planes])
        dtype = computing_dtype(self.stem)  # the cast is done before the copies, to halve them
        return self.features(pixel_unshuffle(torch.cat([plane.to(dtype) for plane in planes], dim=1)))

    def features(self, planes: Float[Tensor, "b _ i j"]) -> Float[Tensor, "b c i j"]:
        """Encode planes that are already pixel-unshuffled by 2."""
        encoded: Tensor = self.blocks(self.stem(planes))
        return encoded


def computing_dtype(layer: nn.Conv2d) -> torch.dtype:
    """The type in which a convolution computes: that of autocast, or else that of its weights."""
    device = layer.weight.device.type
    return torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else layer.weight.dtype


def limit_colours(image: Float[Tensor, "*b h w"]) -> Float[Tensor, "*b h w"]:
    """Clamp an image to `COLOURS`. Hidden references may hold any values, which could overflow float16."""
    return image.clamp(*COLOURS)


def pack_input(
    image: Float[Tensor, "b c h w"], mask: Float[Tensor, "b 1 h w"], shift: float = 0.0
) -> Float[Tensor, "b _ i j"]:
    """Pixel-unshuffle an image plus a shift, and a mask, to bfloat16, where `can_fuse` holds."""
    from gaussian_enhancer.network.bfloat16_kernels import pack_planes

    batch, channels, height, width = image.shape
    result = empty_features(batch, 4 * (channels + 1), height // 2, width // 2)
    with kernel_lock:
        pack_planes(plane(image), np.float32(shift), plane(mask), kernel_words(result, np.uint32))
    return result
