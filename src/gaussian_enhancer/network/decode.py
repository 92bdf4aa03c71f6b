"""Decoder from fused features to the residual.

Axes: b batch, c channels, h height, w width, i = h / 2, j = w / 2.
"""

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.bfloat16 import can_fuse, empty_features, kernel_lock, kernel_words
from gaussian_enhancer.network.block import Block
from gaussian_enhancer.network.initialisation import zero_initialise


class Decoder(nn.Module):
    """A shallow U-Net that starts at half resolution, followed by one pixel-shuffle to full resolution.

    Each level halves the resolution. On the way up, the skip features of the way down are added. All layers are
    convolutions, so that the output at a pixel depends on a bounded neighbourhood. The last convolution is zero at
    initialisation.

    Args:
        widths: number of channels of each level, the first at half resolution.
        blocks: number of residual blocks of each level; the coarsest level has them once, the others on the way down
            and on the way up.
        outputs: number of output channels at full resolution.
    """

    def __init__(self, widths: Sequence[int], blocks: Sequence[int], outputs: int) -> None:
        super().__init__()
        levels = list(zip(widths[:-1], widths[1:], blocks[:-1], strict=True))
        self.down = nn.ModuleList(_stack(fine, count) for fine, _, count in levels)
        self.shrink = nn.ModuleList(nn.Conv2d(fine, coarse, 2, stride=2) for fine, coarse, _ in levels)
        self.middle = _stack(widths[-1], blocks[-1])
        self.grow = nn.ModuleList(nn.Conv2d(coarse, 4 * fine, 1) for fine, coarse, _ in levels)
        self.up = nn.ModuleList(_stack(fine, count) for fine, _, count in levels)
        self.head = nn.Conv2d(widths[0], 4 * outputs, 3, padding=1)
        zero_initialise(self.head)

    def forward(self, x: Float[Tensor, "b c i j"]) -> Float[Tensor, "b o h w"]:
        """Decode features whose sides are multiples of 2^(levels - 1)."""
        return self.outputs(self.features(x))

    def features(self, x: Float[Tensor, "b c i j"]) -> Float[Tensor, "b c i j"]:
        """Apply the U-Net to features, without the last convolution."""
        skips = []
        for blocks, shrink in zip(self.down, self.shrink, strict=True):
            skips.append(blocks(x))
            x = shrink(skips[-1])
        x = self.middle(x)
        for blocks, grow, skip in reversed(list(zip(self.up, self.grow, skips, strict=True))):
            x = blocks(upsample_with_skip(grow(x), skip))
        return x

    def outputs(self, features: Float[Tensor, "b c i j"]) -> Float[Tensor, "b o h w"]:
        """Convert the result of `features` to outputs at full resolution."""
        return pixel_shuffle(self.head(features))


def _stack(channels: int, count: int) -> nn.Sequential:
    return nn.Sequential(*(Block(channels) for _ in range(count)))


def upsample_with_skip(x: Float[Tensor, "b _ h w"], skip: Float[Tensor, "b c _ _"]) -> Float[Tensor, "b c _ _"]:
    """Pixel-shuffle features to twice their resolution, and add the encoder's features of that resolution."""
    if not (x.dtype == skip.dtype == torch.bfloat16 and can_fuse(x, skip)):
        return skip + F.pixel_shuffle(x, 2)
    from gaussian_enhancer.network.bfloat16_kernels import shuffle_and_add

    result = empty_features(*skip.shape)
    with kernel_lock:
        shuffle_and_add(kernel_words(x), kernel_words(skip), kernel_words(result))
    return result


def pixel_shuffle(x: Float[Tensor, "b _ i j"]) -> Float[Tensor, "b o h w"]:
    """Pixel-shuffle by 2, from features to planes."""
    if not (x.dtype == torch.bfloat16 and can_fuse(x)):
        return F.pixel_shuffle(x, 2)
    from gaussian_enhancer.network.bfloat16_kernels import shuffle

    batch, channels, height, width = x.shape
    result = torch.empty(batch, channels // 4, 2 * height, 2 * width, dtype=x.dtype)
    with kernel_lock:
        shuffle(kernel_words(x), result.view(torch.int16).numpy().view(np.uint16))
    return result
