"""NAFNet, a single-image restoration network: the baseline without references.

Axes: b batch, c channels, h height, w width, i, j sides of the features.
"""

import itertools
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.initialisation import zero_initialise
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.network.pyramid import pad_to_stride
from gaussian_enhancer.types import NetworkInput


class NAFNet(Network):
    """Render + decode(render, alpha), after Chen et al., "Simple Baselines for Image Restoration", ECCV 2022.

    References and depth are ignored. Differences from the paper's network: it works at half resolution on
    pixel-unshuffled input, as SIF does. Channel attention uses the mean over the square around a pixel instead of the
    whole image (`LocalAttention`), so that tiles give the same result as the whole image, and crops in training have
    the same statistics as whole images. Residual scales start at 1/5 instead of 0, as SIF's do.

    Its sizes are derived from SIF's, so that both have as many parameters. Each of SIF's residual blocks becomes two
    of NAFNet's. In place of SIF's encoders, fusion and depth there are three additional blocks, for each block of its
    encoders, at the finest level (down and up) and at the coarsest.

    Args:
        widths: channels at 1/2, 1/4, 1/8, ... of the resolution.
        blocks: SIF's residual blocks at each of these levels.
        encoder_blocks: number of residual blocks of SIF's encoders.
        window: side in pixels of the squares that channel attention averages over, a multiple of 2^levels.
    """

    def __init__(
        self,
        widths: Sequence[int] = (32, 64, 96),
        blocks: Sequence[int] = (2, 2, 3),
        encoder_blocks: int = 1,
        window: int = 32,
    ) -> None:
        super().__init__()
        self.describe(locals())
        widths, blocks = [int(c) for c in widths], [int(n) for n in blocks]
        if window < 1 or window % 2 ** len(widths):
            raise ValueError(f"window is {window}, no multiple of {2 ** len(widths)}")
        self.stride = window
        counts = [2 * count for count in blocks]
        counts[0] += 3 * encoder_blocks
        counts[-1] += 3 * encoder_blocks
        cells = [window // 2 ** (level + 1) for level in range(len(widths))]
        stacks = list(zip(widths, counts, cells, strict=True))
        steps = list(itertools.pairwise(widths))
        self.stem = nn.Conv2d(16, widths[0], 3, padding=1)
        self.down = nn.ModuleList(_stack(*level) for level in stacks[:-1])
        self.shrink = nn.ModuleList(nn.Conv2d(fine, coarse, 2, stride=2) for fine, coarse in steps)
        self.middle = _stack(*stacks[-1])
        self.grow = nn.ModuleList(nn.Conv2d(coarse, 4 * fine, 1) for fine, coarse in steps)
        self.up = nn.ModuleList(_stack(*level) for level in stacks[:-1])
        self.head = nn.Conv2d(widths[0], 12, 3, padding=1)
        zero_initialise(self.head)

    def stages(self, views: NetworkInput) -> tuple[Float[Tensor, "b 3 h w"], ...]:
        """The enhanced image, as the only scale."""
        height, width = views.render.shape[-2:]
        padded_input = pad_to_stride(
            NetworkInput(views.render, views.references[:, :0], views.visibility[:, :0], None, views.alpha), self.stride
        )
        alpha = torch.ones_like(padded_input.render[:, :1]) if padded_input.alpha is None else padded_input.alpha
        x = self.stem(F.pixel_unshuffle(torch.cat([padded_input.render - 0.5, alpha], dim=1), 2))
        skips = []
        for blocks, shrink in zip(self.down, self.shrink, strict=True):
            skips.append(blocks(x))
            x = shrink(skips[-1])
        x = self.middle(x)
        for blocks, grow, skip in reversed(list(zip(self.up, self.grow, skips, strict=True))):
            x = blocks(skip + F.pixel_shuffle(grow(x), 2))
        residual = F.pixel_shuffle(self.head(x), 2)[..., :height, :width]
        return (views.render + residual.to(views.render.dtype),)


class NAFBlock(nn.Module):
    """x + s conv(attend(gate(depthwise(conv(norm(x)))))), then y + t conv(gate(conv(norm(y)))).

    The gate multiplies one half of the channels by the other; there is no other non-linearity.

    Args:
        channels: number of input and output channels.
        cell: side of the squares of channel attention, in pixels of the features.
    """

    def __init__(self, channels: int, cell: int) -> None:
        super().__init__()
        self.first_norm, self.second_norm = PixelNorm(channels), PixelNorm(channels)
        self.widen = nn.Conv2d(channels, 2 * channels, 1)
        self.depthwise = nn.Conv2d(2 * channels, 2 * channels, 3, padding=1, groups=2 * channels)
        self.attend = LocalAttention(channels, cell)
        self.project = nn.Conv2d(channels, channels, 1)
        self.expand = nn.Conv2d(channels, 2 * channels, 1)
        self.contract = nn.Conv2d(channels, channels, 1)
        self.scales = nn.Parameter(torch.full((2, channels), 0.2))

    def forward(self, x: Float[Tensor, "b c i j"]) -> Float[Tensor, "b c i j"]:
        """Refine features; sides are multiples of the cell."""
        mixed = self.attend(multiply_halves(self.depthwise(self.widen(self.first_norm(x)))))
        x = x + _scale_outputs(self.project, self.scales[0], mixed)
        return x + _scale_outputs(self.contract, self.scales[1], multiply_halves(self.expand(self.second_norm(x))))


class PixelNorm(nn.LayerNorm):
    """Layer normalisation over the channels of each pixel."""

    def forward(self, x: Float[Tensor, "b c i j"]) -> Float[Tensor, "b c i j"]:
        """Normalise; channels-last features need no copy."""
        return super().forward(x.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)


class LocalAttention(nn.Module):
    """x times a linear function of its mean over squares, interpolated bilinearly between the squares' centres.

    This is NAFNet's simplified channel attention with a local mean, as TLC uses it at inference (Chu et al., "Improving
    Image Restoration by Revisiting Global Information Aggregation", ECCV 2022); here it is also used in training.

    Args:
        channels: number of feature channels.
        cell: side of the squares in pixels of the features.
    """

    def __init__(self, channels: int, cell: int) -> None:
        super().__init__()
        self.cell = cell
        self.weigh = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Float[Tensor, "b c i j"]) -> Float[Tensor, "b c i j"]:
        """Scale the channels; sides are multiples of the cell."""
        weights = self.weigh(F.avg_pool2d(x, self.cell))
        return x * F.interpolate(weights, scale_factor=float(self.cell), mode="bilinear", align_corners=False)


def multiply_halves(x: Float[Tensor, "b _ i j"]) -> Float[Tensor, "b _ i j"]:
    """The first half of the channels times the second half."""
    first, second = x.chunk(2, dim=1)
    return first * second


def _scale_outputs(convolution: nn.Conv2d, scale: Tensor, x: Tensor) -> Tensor:
    """A 1x1 convolution with scaled outputs. The weights are scaled, since they are fewer than the output values."""
    assert convolution.bias is not None
    return F.conv2d(x, convolution.weight * scale[:, None, None, None], convolution.bias * scale)


def _stack(channels: int, count: int, cell: int) -> nn.Sequential:
    return nn.Sequential(*(NAFBlock(channels, cell) for _ in range(count)))
