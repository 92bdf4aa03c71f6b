"""The degradation factor combiner: L = DC(M, z).

Axes: b batch, c channels, h height, w width, m = ceil(h / 8), n = ceil(w / 8), i and j rows and columns of features.
"""

import itertools
from collections.abc import Iterable, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.degrade.factors import Factors, convolution, linear, whole_cells


class Modulation(nn.Module):
    """Scale and shift of features by z: from the vector everywhere alike, from the grid cell by cell.

    Args:
        vector: entries of z's vector.
        grid: channels of z's grid.
        channels: of the features.
    """

    def __init__(self, vector: int, grid: int, channels: int) -> None:
        super().__init__()
        self.everywhere = linear(vector, 2 * channels)
        self.local = convolution(grid, 2 * channels, 1)

    def forward(self, features: Float[Tensor, "b c i j"], factors: Factors) -> Float[Tensor, "b c i j"]:
        """Modulate features of any resolution."""
        both = self.everywhere(factors.vector)[:, :, None, None] + self.local(factors.grid)
        both = F.interpolate(both, size=features.shape[-2:], mode="bilinear", align_corners=False)
        scale, shift = both.to(features.dtype).chunk(2, dim=1)
        return features * (1 + scale) + shift


class ModulatedBlock(nn.Module):
    """x + conv(relu(modulated(conv(x)))).

    Args:
        channels: of input and output.
        vector: entries of z's vector.
        grid: channels of z's grid.
    """

    def __init__(self, channels: int, vector: int, grid: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.modulation = Modulation(vector, grid, channels)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Float[Tensor, "b c i j"], factors: Factors) -> Float[Tensor, "b c i j"]:
        """Refine features as z says."""
        return x + 0.2 * self.second(F.relu(self.modulation(self.first(x), factors)))


class FactorCombiner(nn.Module):
    """L = M + U(M, z, noise): a small U-net whose every block is modulated by z (paper, equation 6).

    DiffIR's transformer is replaced by convolutions, and white noise enters beside M, from which the network makes the
    texture that no code of cells can hold. The last convolution is zero at birth, so that training starts from L = M.

    Args:
        vector: entries of z's vector.
        grid: channels of z's grid.
        widths: channels at 1/2, 1/4 and 1/8 of the resolution.
        blocks: modulated blocks at each resolution, on the way down and again on the way up.
    """

    def __init__(self, vector: int = 32, grid: int = 4, widths: Sequence[int] = (32, 48, 64), blocks: int = 1) -> None:
        super().__init__()
        self.stem = nn.Conv2d(16, widths[0], 3, padding=1)

        def stack(width: int) -> nn.ModuleList:
            return nn.ModuleList([ModulatedBlock(width, vector, grid) for _ in range(blocks)])

        self.down = nn.ModuleList([stack(width) for width in widths])
        self.shrink = nn.ModuleList([nn.Conv2d(a, b, 2, stride=2) for a, b in itertools.pairwise(widths)])
        self.grow = nn.ModuleList([nn.Conv2d(b, a, 1) for a, b in itertools.pairwise(widths)])
        self.up = nn.ModuleList([stack(width) for width in widths[:-1]])
        self.head = nn.Conv2d(widths[0], 12, 3, padding=1)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)  # type: ignore[arg-type]

    def forward(
        self, manual: Float[Tensor, "b 3 h w"], factors: Factors, noise: Float[Tensor, "b 1 h w"]
    ) -> Float[Tensor, "b 3 h w"]:
        """Make the final degraded view, not clamped.

        Args:
            manual: stage 1's output M.
            factors: z.
            noise: standard normal.
        """
        height, width = manual.shape[-2:]
        x = self.stem(F.pixel_unshuffle(whole_cells(torch.cat([manual, noise], dim=1)), 2))
        skips = []
        for level, blocks in enumerate(self.down):
            x = _through(blocks.children(), x, factors)
            if level < len(self.shrink):
                skips.append(x)
                x = self.shrink[level](x)
        for level in reversed(range(len(self.grow))):
            x = F.interpolate(self.grow[level](x), scale_factor=2, mode="bilinear", align_corners=False)
            x = x + skips[level]
            x = _through(self.up[level].children(), x, factors)
        change = F.pixel_shuffle(self.head(F.relu(x)), 2)
        return manual + change[..., :height, :width].to(manual.dtype)


def _through(blocks: Iterable[nn.Module], x: Tensor, factors: Factors) -> Tensor:
    for block in blocks:
        x = block(x, factors)
    return x
