"""The residual block of the networks.

Axes: b batch, c channels, h height, w width (of the features).
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.fused_convolution import convolution


class Block(nn.Module):
    """Residual pair of 3x3 convolutions with one activation between them and no normalisation.

    x + s * conv(relu(conv(x))), with s per channel, small at initialisation so that a deep stack starts near the
    identity (as the scales of NAFNet, Chen et al., ECCV 2022). No operation depends on the whole image, so that tiles
    give the same result as the whole image. Of layers with equally many parameters, plain 3x3 convolutions are the
    fastest in bfloat16 on CPUs.

    Args:
        channels: number of input and output channels.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)
        self.scale = nn.Parameter(torch.full((channels, 1, 1), 0.2))

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        """Refine features."""
        return convolution(convolution(x, self.first, relu=True), self.second, scale=self.scale, plus=x)
