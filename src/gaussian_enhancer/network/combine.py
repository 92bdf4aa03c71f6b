"""Combination of the results of coarser scales at a finer scale.

Axes: b batch, d channels that a coarser scale passes on, h height, w width (both even), i = h / 2, j = w / 2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.bfloat16 import can_fuse, empty_features, kernel_lock, kernel_words, plane
from gaussian_enhancer.network.block import Block
from gaussian_enhancer.network.fused_convolution import convolution
from gaussian_enhancer.network.initialisation import zero_initialise


@runtime_checkable
class Combine(Protocol):
    """A frozen dataclass of plain values that selects how scales are combined."""

    @property
    def handed(self) -> int:
        """Number of channels that a scale passes to finer ones, in addition to the change of its image."""
        ...

    def build(self, channels: int, coarser: int) -> nn.Module:
        """Build the module for a scale, given the numbers of feature channels and of coarser scales."""
        ...


class Combination(nn.Module):
    """E = T + up(sum_k g_k (E_k - render_k)) + r, with gains g and residual r per pixel, predicted from all scales.

    Changes are combined instead of images, since a coarser image lacks the render's detail and its change does not.
    Gains and residual are zero at initialisation. All but the residual is computed at half resolution, at a quarter of
    the cost.

    Args:
        coarser: number of coarser scales.
        handed: number of channels that each of them passes on, in addition to its image's change.
        width: number of internal channels.
    """

    def __init__(self, coarser: int, handed: int, width: int) -> None:
        super().__init__()
        self.join = nn.Conv2d(12 + coarser * (3 + handed), width, 3, padding=1)
        self.block = Block(width)
        self.head = nn.Conv2d(width, 12 + coarser, 3, padding=1)
        zero_initialise(self.head)

    def forward(
        self,
        fine: Float[Tensor, "b 3 h w"],
        render: Float[Tensor, "b 3 h w"],
        coarser: Sequence[Float[Tensor, "b d _ _"]],
    ) -> Float[Tensor, "b 3 h w"]:
        """Combine scales.

        Args:
            fine: this scale's own enhanced image.
            render: render at this scale.
            coarser: for each coarser scale, its image's change and the further channels that it passes on, coarsest
                first.
        """
        height, width = fine.shape[-2:]
        half_size = [_resize(values, height // 2, width // 2) for values in coarser]
        if fine.dtype == torch.float32 and can_fuse(fine, render, *half_size):
            return self._combine_compiled(fine, render, half_size)
        x = torch.cat([F.pixel_unshuffle(fine - render, 2), *half_size], dim=1)
        x = F.relu(self.join(x.to(self.join.weight.dtype)))
        x = self.head(self.block(x)).to(fine.dtype)
        change = sum(x[:, 12 + k : 13 + k] * values[:, :3].to(fine.dtype) for k, values in enumerate(half_size))
        return fine + F.interpolate(change, scale_factor=2, mode="bilinear") + F.pixel_shuffle(x[:, :12], 2)

    def _combine_compiled(
        self,
        fine: Float[Tensor, "b 3 h w"],
        render: Float[Tensor, "b 3 h w"],
        coarser_scales: Sequence[Float[Tensor, "b d _ _"]],
    ) -> Float[Tensor, "b 3 h w"]:
        """Compiled version of `forward`, where `can_fuse` holds."""
        from gaussian_enhancer.network.bfloat16_kernels import combine, pack_combination

        step, coarser = coarser_scales[0].shape[1], plane(torch.cat(list(coarser_scales), dim=1))
        images = list(zip(plane(fine), plane(render), coarser, strict=True))
        joined, result = empty_features(len(fine), 12 + coarser.shape[1], *coarser.shape[2:]), torch.empty(fine.shape)
        with kernel_lock:
            for inputs, words in zip(images, kernel_words(joined), strict=True):
                pack_combination(*inputs, words)
        decoded = convolution(self.block(convolution(joined, self.join, relu=True)), self.head)
        with kernel_lock:
            for (image, _, values), words, combined in zip(images, kernel_words(decoded), result, strict=True):
                combine(image, words, values, step, combined.numpy())
        return result


class NoCombination(nn.Module):
    """No combination: coarser scales have no effect."""

    def forward(
        self,
        fine: Float[Tensor, "b 3 h w"],
        render: Float[Tensor, "b 3 h w"],
        coarser: Sequence[Float[Tensor, "b d _ _"]],
    ) -> Float[Tensor, "b 3 h w"]:
        """Return the scale's own image."""
        return fine


@dataclass(frozen=True)
class Combined:
    """Choice of combining scales; see `Combination` for the parameters. Width None means the features' width."""

    handed: int = 8
    width: int | None = None

    def build(self, channels: int, coarser: int) -> nn.Module:
        """Build the module for a scale, given the numbers of feature channels and of coarser scales."""
        return Combination(coarser, self.handed, self.width or channels)


@dataclass(frozen=True)
class Uncombined:
    """Choice of independent scales: only the finest scale determines the result."""

    handed: ClassVar[int] = 0

    def build(self, channels: int, coarser: int) -> nn.Module:
        """Build the module for a scale, given the numbers of feature channels and of coarser scales."""
        return NoCombination()


def _resize(image: Float[Tensor, "b d _ _"], height: int, width: int) -> Float[Tensor, "b d {height} {width}"]:
    if image.shape[-2:] == (height, width):
        return image
    return F.interpolate(image, size=(height, width), mode="bilinear", align_corners=False)
