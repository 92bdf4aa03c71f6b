"""The degradation factor extractor: z = DE(M, R).

Axes: b batch, n image channels, c and k feature channels, h height, w width, i = ceil(h / 8), j = ceil(w / 8).
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.degrade.generative.factors import Factors, convolution, linear, pad_to_cells
from gaussian_enhancer.degrade.generative.texture import OCTAVES, amplitudes


class Refine(nn.Module):
    """Residual block x + conv(relu(conv(x))), whose second convolution has zero weights at initialisation.

    Args:
        channels: channels of input and output.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)
        nn.init.zeros_(self.second.weight)

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
        """Apply the block."""
        return x + self.second(F.relu(self.first(x)))


class Trunk(nn.Module):
    """Features of cells of images: pixel unshuffle by 4, residual blocks, strided convolution by 2, residual blocks.

    Args:
        inputs: channels of the images.
        width: channels of the features.
        blocks: residual blocks at each of the two resolutions.
    """

    def __init__(self, inputs: int, width: int, blocks: int) -> None:
        super().__init__()
        self.stem = nn.Conv2d(16 * inputs, width, 3, padding=1)
        self.fine = nn.Sequential(*[Refine(width) for _ in range(blocks)])
        self.halve = nn.Conv2d(width, width, 4, stride=2, padding=1)
        self.coarse = nn.Sequential(*[Refine(width) for _ in range(blocks)])

    def forward(self, images: Float[Tensor, "b n h w"]) -> Float[Tensor, "b k i j"]:
        """Features of each cell of 8 x 8 pixels."""
        x = self.stem(F.pixel_unshuffle(pad_to_cells(images), 4))
        return self.coarse(F.relu(self.halve(self.fine(x))))


class FactorExtractor(nn.Module):
    """z = DE(M, R), which encodes how the real render R differs from the manually degraded view M (paper, equation 5).

    After DiffIR's first-stage encoder (Xia et al., ICCV 2023), with two differences: z has a grid in addition to the
    vector, and the change of the strength of detail from M to R is an additional input.

    Args:
        vector: entries of z's vector, 0 for none.
        grid: channels of z's grid, 0 for none.
        width: channels of the features.
        blocks: residual blocks at each of the two resolutions.
    """

    def __init__(self, vector: int = 32, grid: int = 8, width: int = 64, blocks: int = 2) -> None:
        super().__init__()
        self.trunk = Trunk(6, width, blocks)
        self.texture = nn.Conv2d(3 * (OCTAVES + 2), width, 1)
        self.vector = nn.Sequential(nn.Linear(width, width), nn.ReLU(), linear(width, vector))
        self.grid = convolution(width, grid, 1)

    def forward(self, manual: Float[Tensor, "b 3 h w"], real: Float[Tensor, "b 3 h w"]) -> Factors:
        """Extract the factors.

        Args:
            manual: stage 1's output M.
            real: real renders R of the same views.
        """
        change = amplitudes(real.float()).log() - amplitudes(manual.float()).log()
        features = self.trunk(torch.cat([manual, real - manual], dim=1)) + self.texture(change.to(real.dtype))
        return Factors(self.vector(features.mean(dim=(2, 3))), self.grid(features))
