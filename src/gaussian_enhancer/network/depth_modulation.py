"""Depth modulation: features are scaled and shifted by functions of depth.

Axes: b batch, c channels, h height, w width (both even), i = h / 2, j = w / 2.
"""

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.align.depth_normalisation import depth_unit, normalised_inverse_depth
from gaussian_enhancer.network.bfloat16 import can_fuse, empty_features, kernel_lock, kernel_words, plane
from gaussian_enhancer.network.fused_convolution import convolution
from gaussian_enhancer.network.halving import halve, pixel_unshuffle
from gaussian_enhancer.network.initialisation import zero_initialise
from gaussian_enhancer.types import FARTHEST_DEPTH, usable_depth


class DepthModulation(nn.Module):
    """E = S(H, D) = H (1 + a(D)) + b(D), with a and b zero at initialisation and wherever there is no depth.

    Args:
        channels: number of modulated feature channels.
        width: number of channels of the depth branch.
    """

    def __init__(self, channels: int, width: int = 24) -> None:
        super().__init__()
        self.stem = nn.Conv2d(8, width, 3, padding=1)
        self.widen = nn.Conv2d(width, width, 3, padding=1)
        self.modulate = nn.Conv2d(width, 2 * channels, 1)
        zero_initialise(self.modulate)

    def forward(
        self,
        features: Float[Tensor, "b c i j"],
        depth: Float[Tensor, "b 1 h w"] | None,
        unit: Float[Tensor, " b"] | None,
    ) -> Float[Tensor, "b c i j"]:
        """Modulate features at half resolution.

        Args:
            features: fused features.
            depth: z in scene units at full resolution; None returns the features unchanged.
            unit: the length that counts as 1; None means the median depth.
        """
        if depth is None:
            return features
        unit = depth_unit(depth) if unit is None else unit
        if features.dtype == torch.bfloat16 and can_fuse(features, depth):
            return self._modulate_compiled(features, depth, unit)
        inverse = normalised_inverse_depth(depth, unit)
        known_depth = usable_depth(depth).to(inverse.dtype)
        x = pixel_unshuffle(torch.cat([inverse, known_depth], dim=1).to(self.stem.weight.dtype))
        scale, shift = self.modulate(F.relu(self.widen(F.relu(self.stem(x))))).chunk(2, dim=1)
        share = halve(known_depth).to(features.dtype)
        return features + share * (features * scale + shift)

    def _modulate_compiled(
        self, features: Float[Tensor, "b c i j"], depth: Float[Tensor, "b 1 h w"], unit: Float[Tensor, " b"]
    ) -> Float[Tensor, "b c i j"]:
        """Compiled version of `forward`, where `can_fuse` holds."""
        from gaussian_enhancer.network.bfloat16_kernels import modulate, pack_depth

        batch, size = len(features), features.shape[-2:]
        planes, share = empty_features(batch, 8, *size), torch.empty(batch, *size)
        images = plane(depth[:, 0]), plane(unit), kernel_words(planes, np.uint32), share.numpy()
        with kernel_lock:
            for image, length, words, usable in zip(*images, strict=True):
                pack_depth(image, length, np.float32(FARTHEST_DEPTH), words, usable)
        hidden = convolution(convolution(planes, self.stem, relu=True), self.widen, relu=True)
        modulation, result = convolution(hidden, self.modulate), empty_features(*features.shape)
        with kernel_lock:
            modulate(kernel_words(features), kernel_words(modulation), share.numpy(), kernel_words(result))
        return result


class NoModulation(nn.Module):
    """No depth modulation."""

    def forward(
        self,
        features: Float[Tensor, "b c i j"],
        depth: Float[Tensor, "b 1 h w"] | None,
        unit: Float[Tensor, " b"] | None,
    ) -> Float[Tensor, "b c i j"]:
        """Return the features."""
        return features


@dataclass(frozen=True)
class DepthModulated:
    """Choice of depth modulation; see `DepthModulation`."""

    width: int = 24

    def build(self, channels: int) -> nn.Module:
        """Build the module for features with this number of channels."""
        return DepthModulation(channels, self.width)


@dataclass(frozen=True)
class Unmodulated:
    """Choice of no depth modulation."""

    def build(self, channels: int) -> nn.Module:
        """Build the module for features with this number of channels."""
        return NoModulation()
