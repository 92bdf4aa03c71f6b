"""The degradation factor combiner: L = DC(M, z).

Axes: b batch, c channels, h height, w width, m = ceil(h / 8), n = ceil(w / 8), i and j rows and columns of features.
"""

import itertools
from collections.abc import Iterable, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.degrade.artefacts.displacement import displace
from gaussian_enhancer.degrade.generative.factors import CELL, Factors, convolution, linear, pad_to_cells
from gaussian_enhancer.degrade.generative.texture import OCTAVES, octaves

REACH = 4.0
"""Largest displacement along each axis in pixels."""

RESIDUE = 0.25
"""Largest absolute value of the tone, and of the residue, for colours in [0, 1]."""

SMOOTH_PLANES = 2 + OCTAVES + 3
"""Smooth parameter planes: displacement for each axis, contrast for each octave, tone for each channel."""


class Modulation(nn.Module):
    """Scale and shift of features, predicted from z: globally from its vector, per cell from its grid.

    Args:
        vector: entries of z's vector.
        grid: channels of z's grid.
        channels: channels of the features.
    """

    def __init__(self, vector: int, grid: int, channels: int) -> None:
        super().__init__()
        self.everywhere = linear(vector, 2 * channels)
        self.local = convolution(grid, 2 * channels, 1)

    def forward(self, features: Float[Tensor, "b c i j"], factors: Factors) -> Float[Tensor, "b c i j"]:
        """Modulate features of any resolution."""
        modulation = self.everywhere(factors.vector)[:, :, None, None] + self.local(factors.grid)
        modulation = F.interpolate(modulation, size=features.shape[-2:], mode="bilinear", align_corners=False)
        scale, shift = modulation.to(features.dtype).chunk(2, dim=1)
        return features * (1 + scale) + shift


class ModulatedBlock(nn.Module):
    """Residual block x + 0.2 conv(relu(modulation(conv(x)))).

    Args:
        channels: channels of input and output.
        vector: entries of z's vector.
        grid: channels of z's grid.
    """

    def __init__(self, channels: int, vector: int, grid: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.modulation = Modulation(vector, grid, channels)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Float[Tensor, "b c i j"], factors: Factors) -> Float[Tensor, "b c i j"]:
        """Refine features, modulated by z."""
        return x + 0.2 * self.second(F.relu(self.modulation(self.first(x), factors)))


class FactorCombiner(nn.Module):
    """L = DC(M, z) (paper, equation 5): a small U-net, modulated by z in every block, predicts how M is degraded.

    DiffIR's transformer, which outputs an image, is replaced by a network that outputs parameters of a degradation: it
    displaces M by up to `REACH` pixels, scales the contrast of each octave of its detail by 0 to 2, and adds a tone and
    a residue of at most `RESIDUE` each. These few parameters can be learnt from few pairs. A network of this size that
    outputs an image learnt neither to blur nor to remove detail in thousands of steps. The grid of z also acts on the
    parameters of its cells directly. White noise is an additional input, for variation that z does not describe. The
    last convolutions are zero at initialisation, so that training starts from L = M.

    Args:
        vector: entries of z's vector.
        grid: channels of z's grid.
        widths: channels at 1/2, 1/4 and 1/8 of the resolution.
        blocks: modulated blocks at each resolution, in the encoder and again in the decoder.
    """

    def __init__(self, vector: int = 32, grid: int = 8, widths: Sequence[int] = (32, 48, 64), blocks: int = 1) -> None:
        super().__init__()
        self.stem = nn.Conv2d(16, widths[0], 3, padding=1)

        def stack(width: int) -> nn.ModuleList:
            return nn.ModuleList([ModulatedBlock(width, vector, grid) for _ in range(blocks)])

        self.down = nn.ModuleList([stack(width) for width in widths])
        self.shrink = nn.ModuleList([nn.Conv2d(a, b, 2, stride=2) for a, b in itertools.pairwise(widths)])
        self.grow = nn.ModuleList([nn.Conv2d(b, a, 1) for a, b in itertools.pairwise(widths)])
        self.up = nn.ModuleList([stack(width) for width in widths[:-1]])
        self.head = nn.Conv2d(widths[0], SMOOTH_PLANES + 12, 3, padding=1)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)  # type: ignore[arg-type]
        self.direct = convolution(grid, SMOOTH_PLANES, 3)
        for parameter in self.direct.parameters():
            nn.init.zeros_(parameter)

    def forward(
        self, manual: Float[Tensor, "b 3 h w"], factors: Factors, noise: Float[Tensor, "b 1 h w"]
    ) -> Float[Tensor, "b 3 h w"]:
        """Compute the final degraded view L, not clamped.

        Args:
            manual: stage 1's output M.
            factors: z.
            noise: standard normal.
        """
        height, width = manual.shape[-2:]
        padded = pad_to_cells(manual)
        output = self._half_resolution_output(torch.cat([padded, pad_to_cells(noise)], dim=1), factors)
        residue = F.pixel_shuffle(output[:, SMOOTH_PLANES:], 2).to(manual.dtype).tanh()
        smooth = _enlarge(output[:, :SMOOTH_PLANES], 2) + _enlarge(self.direct(factors.grid), CELL)
        offset, contrast, tone = smooth.to(manual.dtype).tanh().split((2, OCTAVES, 3), dim=1)
        displaced = displace(padded, REACH * offset)
        contrasted = displaced + sum(contrast[:, k : k + 1] * octave for k, octave in enumerate(octaves(displaced)))
        return (contrasted + RESIDUE * (tone + residue))[..., :height, :width]

    def _half_resolution_output(self, images: Float[Tensor, "b 4 h w"], factors: Factors) -> Float[Tensor, "b k i j"]:
        """The U-net's output at half resolution."""
        x = self.stem(F.pixel_unshuffle(images, 2))
        skips = []
        for level, blocks in enumerate(self.down):
            x = _apply_blocks(blocks.children(), x, factors)
            if level < len(self.shrink):
                skips.append(x)
                x = self.shrink[level](x)
        for level in reversed(range(len(self.grow))):
            x = _enlarge(self.grow[level](x), 2)
            x = _apply_blocks(self.up[level].children(), x + skips[level], factors)
        return self.head(F.relu(x))


def _enlarge(image: Tensor, factor: int) -> Tensor:
    return F.interpolate(image, scale_factor=factor, mode="bilinear", align_corners=False)


def _apply_blocks(blocks: Iterable[nn.Module], x: Tensor, factors: Factors) -> Tensor:
    for block in blocks:
        x = block(x, factors)
    return x
