"""The unit that every part of the network is built from.

Axes: b batch, c channels, h height, w width (of the features).
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.fused_convolution import convolution


class Block(nn.Module):
    """Residual pair of 3x3 convolutions with one activation between and no normalisation.

    x + s * conv(relu(conv(x))), s per channel, small at initialisation so that a deep stack starts near the identity
    (as the scales of NAFNet, Chen et al., ECCV 2022). Nothing looks at the whole image, so that tiles equal the whole;
    plain 3x3 convolutions are what processors run fastest for their parameters in bf16.

    Args:
        channels: of input and output.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)
        self.scale = nn.Parameter(torch.full((channels, 1, 1), 0.2))

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        """Refine features."""
        return convolution(convolution(x, self.first, relu=True), self.second, scale=self.scale, plus=x)
