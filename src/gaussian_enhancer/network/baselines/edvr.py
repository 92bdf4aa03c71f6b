"""EDVR: learned coarse-to-fine alignment of references, and fusion by attention.

Axes: b batch, r references, f frames (render and references of a batch, or references only), c channels, h height,
w width, i, j sides of the features.
"""

import math
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.block import Block
from gaussian_enhancer.network.deform import deformable_sample
from gaussian_enhancer.network.initialisation import zero_initialise
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.network.pyramid import pad_to_stride
from gaussian_enhancer.types import NetworkInput


def leaky(x: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
    """EDVR's activation. With plain ReLU, the trained network returned the render unchanged."""
    return F.leaky_relu(x, 0.1)


class EDVR(Network):
    """Render + reconstruct(attend(align(features of render and references))).

    After Wang et al., "EDVR: Video Restoration with Enhanced Deformable Convolutional Networks", CVPRW 2019, in its
    form for full-resolution inputs, whose features have a quarter of the resolution. It is meant for references that
    are not warped (``alignment=none``): it receives neither cameras nor depth. Differences from the paper's network:
    offsets are bounded, zero at initialisation, and predicted from half as many channels; references are of any number
    and summed with weights that include visibility, instead of a fixed number concatenated and convolved; spatial
    attention has one level.

    Its sizes are derived from SIF's, so that both have as many parameters: half as many channels as SIF's coarsest
    level, as many residual blocks before alignment as that level has, and (blocks[0] + 1) times as many in the
    reconstruction.

    Args:
        widths: SIF's channels at each level.
        blocks: SIF's residual blocks at each level.
        groups: number of channel groups; the channels of a group share offsets.
        reach: largest offset in pixels of the features, the same at 1/4, 1/8 and 1/16 of the resolution.
    """

    def __init__(
        self,
        widths: Sequence[int] = (32, 64, 96),
        blocks: Sequence[int] = (2, 2, 3),
        groups: int = 4,
        reach: int = 10,
    ) -> None:
        super().__init__()
        self.describe(locals())
        widths, blocks = [int(c) for c in widths], [int(n) for n in blocks]
        channels, half = widths[-1] // 2, widths[-1] // 4
        front, back = blocks[-1], (blocks[0] + 1) * blocks[-1]
        if channels % groups or channels % 2:
            raise ValueError(f"the coarsest width is {widths[-1]}, no multiple of 4 and of {2 * groups}")
        self.stride = 16
        self.stem = nn.Conv2d(16, half, 3, padding=1)
        self.shrink = nn.Conv2d(half, channels, 3, stride=2, padding=1)
        self.front = nn.Sequential(*(Block(channels) for _ in range(front)))
        self.pyramid = nn.ModuleList(nn.Conv2d(channels, channels, 3, stride=2, padding=1) for _ in range(2))
        self.align = PyramidAlignment(channels, groups, float(reach))
        self.attend = Attention(channels)
        self.back = nn.Sequential(*(Block(channels) for _ in range(back)))
        self.grow = nn.Conv2d(channels, 4 * half, 3, padding=1)
        self.head = nn.Conv2d(half, 12, 3, padding=1)
        zero_initialise(self.head)

    def stages(self, views: NetworkInput) -> tuple[Float[Tensor, "b 3 h w"], ...]:
        """The enhanced image, as the only scale."""
        height, width = views.render.shape[-2:]
        views = pad_to_stride(views, self.stride)
        batch, count = views.references.shape[:2]
        alpha = torch.ones_like(views.render[:, :1]) if views.alpha is None else views.alpha
        rgb_alpha = torch.cat([views.render, alpha], dim=1)
        reference_frames = torch.cat([views.references, views.visibility], dim=2).flatten(0, 1)
        features = self.encode(torch.cat([rgb_alpha, reference_frames]))
        target, fused = features[0][:batch], None
        if count:
            targets = [level[:batch].repeat_interleave(count, dim=0) for level in features]
            aligned = self.align([level[batch:] for level in features], targets)
            visibility = F.avg_pool2d(views.visibility.flatten(0, 1), 4)
            fused = self.attend.gather(aligned, targets[0], visibility, count)
        x = self.back(self.attend(target, torch.zeros_like(target) if fused is None else fused))
        residual = F.pixel_shuffle(self.head(leaky(F.pixel_shuffle(self.grow(x), 2))), 2)[..., :height, :width]
        return (views.render[..., :height, :width] + residual.to(views.render.dtype),)

    def encode(self, frames: Float[Tensor, "f 4 h w"]) -> list[Float[Tensor, "f c _ _"]]:
        """Features of colours and mask at 1/4, 1/8 and 1/16 of the resolution."""
        colours, mask = frames.split([3, 1], dim=1)
        x = F.pixel_unshuffle(torch.cat([colours - 0.5, mask], dim=1), 2)
        levels = [self.front(leaky(self.shrink(leaky(self.stem(x)))))]
        for shrink in self.pyramid:
            levels.append(leaky(shrink(levels[-1])))
        return levels


class PyramidAlignment(nn.Module):
    """EDVR's PCD alignment: from the coarsest level to the finest, each level starting from the previous offsets.

    A cascade at the finest level refines the result. The offsets of each step are bounded and zero at initialisation.

    Args:
        channels: number of feature channels.
        groups: number of channel groups; the channels of a group share offsets.
        reach: largest offset of each step in pixels of its level.
    """

    def __init__(self, channels: int, groups: int, reach: float) -> None:
        super().__init__()
        self.levels = nn.ModuleList(OffsetStep(channels, groups, reach, level < 2) for level in range(3))
        self.cascade = OffsetStep(channels, groups, reach, has_coarser=False)

    def forward(
        self, references: Sequence[Float[Tensor, "f c _ _"]], targets: Sequence[Float[Tensor, "f c _ _"]]
    ) -> Float[Tensor, "f c i j"]:
        """Align references to targets, both given from fine to coarse."""
        coarser = None
        for step, reference, target in reversed(list(zip(self.levels, references, targets, strict=True))):
            coarser = step(reference, target, coarser)
        assert coarser is not None
        return leaky(self.cascade(coarser[1], targets[0], None)[1])


class OffsetStep(nn.Module):
    """A modulated deformable convolution. Its offsets depend on reference, target and the coarser level.

    Args:
        channels: number of feature channels.
        groups: number of channel groups; the channels of a group share offsets.
        reach: largest offset in pixels.
        has_coarser: whether there is a coarser level.
    """

    def __init__(self, channels: int, groups: int, reach: float, has_coarser: bool) -> None:
        super().__init__()
        self.groups, self.reach = groups, reach
        half = channels // 2
        self.compare = nn.Conv2d(2 * channels, half, 3, padding=1)
        self.inform = nn.Conv2d(2 * half, half, 3, padding=1) if has_coarser else None
        self.predict = nn.Conv2d(half, 3 * 9 * groups, 3, padding=1)
        zero_initialise(self.predict)
        self.mix = nn.Conv2d(channels, channels, 3, padding=1)
        self.join = nn.Conv2d(2 * channels, channels, 3, padding=1) if has_coarser else None

    def forward(
        self,
        reference: Float[Tensor, "f c i j"],
        target: Float[Tensor, "f c i j"],
        coarser: tuple[Float[Tensor, "f o k l"], Float[Tensor, "f c k l"]] | None,
    ) -> tuple[Float[Tensor, "f o i j"], Float[Tensor, "f c i j"]]:
        """Return offset features, for the next finer level, and the aligned features."""
        offset_features = leaky(self.compare(torch.cat([reference, target], dim=1)))
        if self.inform is not None and coarser is not None:
            # Doubled, since an offset of one coarse pixel equals two fine pixels.
            offset_features = leaky(self.inform(torch.cat([offset_features, 2 * _upsample_2x(coarser[0])], dim=1)))
        aligned = deformable_sample(reference, *self.predict_offsets(offset_features), self.mix.weight, self.mix.bias)
        if self.join is not None and coarser is not None:
            aligned = self.join(torch.cat([aligned, _upsample_2x(leaky(coarser[1]))], dim=1))
        return offset_features, aligned

    def predict_offsets(
        self, offset_features: Float[Tensor, "f o i j"]
    ) -> tuple[Float[Tensor, "f _ i j"], Float[Tensor, "f _ i j"]]:
        """Offsets, bounded by ``reach``, and masks in [0, 2], predicted from offset features."""
        x = self.predict(offset_features).float()
        split = 2 * 9 * self.groups
        return self.reach * torch.tanh(x[:, :split]), 2 * torch.sigmoid(x[:, split:])


class Attention(nn.Module):
    """EDVR's TSA fusion: weighted mean of the references by similarity to the target, then spatial attention.

    w_i = v_i sigmoid(<e(a_i), e'(t)> / sqrt(c)), mean = sum_i w_i a_i / (1 + sum_i w_i), for visibility v, aligned
    features a and the target's features t. References may have any order and number; one that is not visible has no
    effect.

    Args:
        channels: number of feature channels.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.embed_reference = nn.Conv2d(channels, channels, 3, padding=1)
        self.embed_target = nn.Conv2d(channels, channels, 3, padding=1)
        self.fuse = nn.Conv2d(2 * channels, channels, 1)
        self.squeeze = nn.Conv2d(2 * channels, channels, 1)
        self.look = nn.Conv2d(channels, channels, 3, padding=1)
        self.weigh = nn.Conv2d(channels, channels, 3, padding=1)
        self.shift = nn.Conv2d(channels, channels, 1)

    def gather(
        self,
        aligned: Float[Tensor, "f c i j"],
        target: Float[Tensor, "f c i j"],
        visibility: Float[Tensor, "f 1 i j"],
        count: int,
    ) -> Float[Tensor, "b c i j"]:
        """Weighted mean of the aligned references of each target.

        Args:
            aligned: features of all references of all targets.
            target: features of the target, repeated for each of its references.
            visibility: visibility of the references at the features' resolution.
            count: number of references of each target.
        """
        similarity = (self.embed_reference(aligned) * self.embed_target(target)).float().sum(1, keepdim=True)
        weights = visibility * torch.sigmoid(similarity / math.sqrt(aligned.shape[1]))
        total = (weights.to(aligned.dtype) * aligned).unflatten(0, (-1, count)).sum(1)
        return total / (1 + weights.unflatten(0, (-1, count)).sum(1)).to(total.dtype)

    def forward(
        self, target: Float[Tensor, "b c i j"], reference_mean: Float[Tensor, "b c i j"]
    ) -> Float[Tensor, "b c i j"]:
        """Fuse the target's features with the references' mean ``reference_mean``; sides are even."""
        fused = leaky(self.fuse(torch.cat([target, reference_mean], dim=1)))
        pooled = torch.cat([F.max_pool2d(fused, 3, 2, 1), F.avg_pool2d(fused, 3, 2, 1)], dim=1)
        weight = self.weigh(_upsample_2x(leaky(self.look(leaky(self.squeeze(pooled))))))
        return fused * 2 * torch.sigmoid(weight) + self.shift(weight)


def _upsample_2x(x: Float[Tensor, "f c i j"]) -> Float[Tensor, "f c _ _"]:
    """Features upsampled by 2."""
    return F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
