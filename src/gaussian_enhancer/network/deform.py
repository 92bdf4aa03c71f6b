"""Modulated deformable sampling (DCNv2: Zhu et al., CVPR 2019) by grid_sample.

Axes: b batch, r references, c channels, d output channels, h height, w width, k kernel side.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.initialisation import zero_initialise
from gaussian_enhancer.types import single_precision


def deformable_sample(
    x: Float[Tensor, "b c h w"],
    offset: Float[Tensor, "b _ h w"],
    mask: Float[Tensor, "b _ h w"],
    weight: Float[Tensor, "d c k k"],
    bias: Float[Tensor, " d"] | None = None,
) -> Float[Tensor, "b d h w"]:
    """Modulated deformable convolution, stride 1, padding k // 2, zero outside the image.

    y(p) = sum_k W_k m_k(p) x(p + p_k + offset_k(p)), with separate offsets and masks per group of channels. The result
    and the layout are those of torchvision.ops.deform_conv2d: channel 2 (g k^2 + tap) of offset is the shift along y,
    the next one along x. Positions are computed at least in single precision.

    Args:
        x: features.
        offset: shifts in pixels, 2 g k^2 channels for g groups.
        mask: factor on each tap, g k^2 channels.
        weight: weight of the convolution.
        bias: bias of the convolution.
    """
    batch, channels, height, width = x.shape
    side = weight.shape[-1]
    taps, groups = side * side, mask.shape[1] // (side * side)
    dtype = torch.promote_types(x.dtype, torch.float32)
    offset = offset.to(dtype).reshape(batch * groups, taps, 2, height, width)
    taps_1d = torch.arange(side, device=x.device, dtype=dtype) - side // 2
    row = torch.arange(height, device=x.device, dtype=dtype)[:, None] + taps_1d.repeat_interleave(side)[:, None, None]
    column = torch.arange(width, device=x.device, dtype=dtype) + taps_1d.repeat(side)[:, None, None]
    grid = torch.stack(
        [(2 * (offset[:, :, 1] + column) + 1) / width - 1, (2 * (offset[:, :, 0] + row) + 1) / height - 1], dim=-1
    )
    with torch.autocast(x.device.type, enabled=False):
        samples = F.grid_sample(
            x.to(dtype).reshape(batch * groups, channels // groups, height, width),
            grid.view(batch * groups, taps * height, width, 2),
            align_corners=False,
        )
    samples = samples.view(batch, groups, channels // groups, taps, height, width)
    samples = samples * mask.to(dtype).reshape(batch, groups, 1, taps, height, width)
    samples = samples.reshape(batch, channels * taps, height, width).to(x.dtype)
    return F.conv2d(samples, weight.reshape(weight.shape[0], -1, 1, 1), bias)


class Deformation(nn.Module):
    """Samples each reference's features at offsets predicted from the target's features.

    Offsets are reach x tanh(.) (BasicVSR++'s remedy against diverging offsets, Chan et al., CVPR 2022), and masks are
    2 x sigmoid(.). Both come from a zero-initialised convolution, so that the module starts as a plain convolution.
    They are predicted at half the features' resolution, which enlarges the receptive field at a quarter of the cost.

    Args:
        channels: number of feature channels.
        kernel: side of the sampled neighbourhood, odd; 1 moves features without mixing neighbours.
        groups: number of channel groups; the channels of a group share offsets.
        reach: largest offset in pixels of the features; None leaves offsets unbounded, as in DCNv2.
        width: number of sampled channels, a multiple of groups; fewer are faster, None means all.
    """

    def __init__(
        self, channels: int, kernel: int = 3, groups: int = 4, reach: float | None = 10.0, width: int | None = None
    ) -> None:
        super().__init__()
        self.kernel, self.groups, self.reach = kernel, groups, reach
        taps = groups * kernel * kernel
        self.compare = nn.Conv2d(2 * channels, channels, 4, stride=2, padding=1)
        self.widen = nn.Conv2d(channels, channels, 3, padding=1)
        self.predict = nn.Conv2d(channels, 3 * taps, 3, padding=1)
        zero_initialise(self.predict)
        self.narrow = nn.Identity() if width is None else nn.Conv2d(channels, width, 1)
        self.mix = nn.Conv2d(width or channels, channels, kernel, padding=kernel // 2)
        if kernel == 1 and width is None:
            nn.init.dirac_(self.mix.weight)

    def forward(
        self, references: Float[Tensor, "b r c h w"], target: Float[Tensor, "b c h w"]
    ) -> Float[Tensor, "b r c h w"]:
        """Align references' features to the target's; height and width are even."""
        flat = references.flatten(0, 1)
        x = F.relu(self.compare(torch.cat([flat, target.repeat_interleave(references.shape[1], dim=0)], dim=1)))
        x = self.predict(F.relu(self.widen(x)))
        x = F.interpolate(single_precision(x), scale_factor=2, mode="bilinear", align_corners=False)
        split = 2 * self.groups * self.kernel**2
        offset, mask = x[:, :split], 2 * torch.sigmoid(x[:, split:])
        if self.reach is not None:
            offset = self.reach * torch.tanh(offset)
        aligned = deformable_sample(self.narrow(flat), offset, mask, self.mix.weight, self.mix.bias)
        return aligned.unflatten(0, references.shape[:2])


class NoAlignment(nn.Module):
    """No learned alignment: the references' features are unchanged."""

    def forward(
        self, references: Float[Tensor, "b r c h w"], target: Float[Tensor, "b c h w"]
    ) -> Float[Tensor, "b r c h w"]:
        """Return the references' features."""
        return references


@dataclass(frozen=True)
class Deformable:
    """Choice of learned alignment: modulated deformable sampling; see `Deformation` for the parameters."""

    kernel: int = 3
    groups: int = 4
    reach: float | None = 10.0
    width: int | None = None

    def build(self, channels: int) -> nn.Module:
        """Build the module for features with this number of channels."""
        return Deformation(channels, self.kernel, self.groups, self.reach, self.width)


@dataclass(frozen=True)
class Unrefined:
    """Choice of no learned alignment."""

    def build(self, channels: int) -> nn.Module:
        """Build the module for features with this number of channels."""
        return NoAlignment()
