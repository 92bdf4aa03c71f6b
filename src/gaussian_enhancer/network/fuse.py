"""Fusion of the target's features with those of any number of references.

Axes: b batch, r references, c channels, h height, w width (of the features).
"""

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.network.bfloat16 import can_fuse, empty_features, kernel_lock, kernel_words, plane
from gaussian_enhancer.network.block import Block
from gaussian_enhancer.network.fused_convolution import convolution
from gaussian_enhancer.types import single_precision

LIMIT = 6.0
"""Largest magnitude of a logit, so that no reference outweighs the render completely."""


ZERO_INITIALISED = ("pooled",)
"""Options of fusions that add a module which has no effect at initialisation."""


class TrustFusion(nn.Module):
    """Per-pixel softmax weights over render and references; the weighted sum of values is added to the target.

    w_i = v_i exp(l_i) / (exp(l_0) + sum_j v_j exp(l_j)), fused = target + project(sum_i w_i value_i). Here v is
    visibility, and l is predicted by comparing each reference with the target; l_0 = 0. A reference with visibility 0
    has no effect, and the order of references does not matter. Logits are bounded, so that no reference outweighs the
    render completely.

    With pooling, l and the values also depend on the references' mean features, weighted by visibility, and on the
    number of references: references that agree with each other but not with the render are right where the render is
    wrong (the pooled statistics of IBRNet, Wang et al., CVPR 2021). Pooling has no effect at initialisation.

    Args:
        channels: number of feature channels.
        heads: number of channel groups, each with its own weights.
        pooled: also compare each reference with the mean of all references.
    """

    def __init__(self, channels: int, heads: int = 4, pooled: bool = False) -> None:
        super().__init__()
        self.heads = heads
        self.pool = nn.Conv2d(channels + 1, channels, 3, padding=1, bias=False) if pooled else None
        if self.pool is not None:
            nn.init.zeros_(self.pool.weight)
        self.compare = nn.Conv2d(2 * channels, channels, 3, padding=1)
        self.block = Block(channels)
        self.trust = nn.Conv2d(channels, heads, 3, padding=1)
        self.value = nn.Conv2d(channels, channels, 1)
        self.project = nn.Conv2d(channels, channels, 1)

    def forward(
        self,
        target: Float[Tensor, "b c h w"],
        references: Float[Tensor, "b r c h w"],
        visibility: Float[Tensor, "b r 1 h w"],
    ) -> tuple[Float[Tensor, "b c h w"], Float[Tensor, "b r 1 h w"]]:
        """Fuse features; also return each reference's weight at each pixel."""
        batch, count = references.shape[:2]
        if count == 0:
            return target + self.project(torch.zeros_like(target)), visibility
        compared = self.block(self._compare(target, references, visibility))
        if compared.dtype == torch.bfloat16 and can_fuse(compared, visibility):
            fused_values, trust = self._weigh_compiled(self.trust(compared), self.value(compared), visibility)
            return convolution(fused_values, self.project, plus=target), trust
        logits = LIMIT * torch.tanh(single_precision(self.trust(compared)) / LIMIT)
        scores = single_precision(visibility) * torch.exp(logits).unflatten(0, (batch, count))
        weights = scores / (1 + scores.sum(1, keepdim=True))
        values = self.value(compared).unflatten(0, (batch, count)).unflatten(2, (self.heads, -1))
        # Summed over one reference at a time, to avoid a tensor of all references' products.
        shares = weights.to(values.dtype)[:, :, :, None]
        fused_values = sum((shares[:, i] * values[:, i] for i in range(1, count)), start=shares[:, 0] * values[:, 0])
        # Heads are joined as the last axis, since `flatten(1, 2)` gives one image strides that are not channels-last.
        joined = fused_values.permute(0, 3, 4, 1, 2).flatten(3).permute(0, 3, 1, 2)
        return target + self.project(joined), weights.mean(2, keepdim=True)

    def _compare(
        self,
        target: Float[Tensor, "b c h w"],
        references: Float[Tensor, "b r c h w"],
        visibility: Float[Tensor, "b r 1 h w"],
    ) -> Float[Tensor, "n c h w"]:
        """relu(`compare`) of each reference with the target and, if there is pooling, with the pooled references.

        The contributions of the target and of the pooled references are computed once for all references.
        """
        batch, count, channels = references.shape[:3]
        weight, bias = self.compare.weight, self.compare.bias
        reference_part = F.conv2d(references.flatten(0, 1), weight[:, :channels], padding=1).unflatten(
            0, (batch, count)
        )
        target_part = F.conv2d(target, weight[:, channels:], bias, padding=1)
        if self.pool is not None:
            target_part = target_part + self.pool(_pool_references(references, visibility))
        if reference_part.dtype == torch.bfloat16 and can_fuse(reference_part, target_part):
            _add_and_rectify(reference_part, target_part)
            return reference_part.flatten(0, 1)
        return F.relu(reference_part + target_part[:, None]).flatten(0, 1)

    def _weigh_compiled(
        self, logits: Float[Tensor, "n k h w"], values: Float[Tensor, "n c h w"], visibility: Float[Tensor, "b r 1 h w"]
    ) -> tuple[Float[Tensor, "b c h w"], Float[Tensor, "b r 1 h w"]]:
        """Weighted sum of the references' values, and the mean weight of each reference, where `can_fuse` holds."""
        from gaussian_enhancer.network.bfloat16_kernels import weigh

        leading_shape, trust = visibility.shape[:2], torch.empty_like(visibility, memory_format=torch.contiguous_format)
        fused_values = empty_features(leading_shape[0], *values.shape[1:])
        inputs = (
            kernel_words(features).reshape(*leading_shape, *features.shape[-2:], -1) for features in (logits, values)
        )
        with kernel_lock:
            weigh(
                *inputs,
                plane(visibility[:, :, 0]),
                np.float32(LIMIT),
                kernel_words(fused_values),
                trust[:, :, 0].numpy(),
            )
        return fused_values, trust


def _add_and_rectify(references: Float[Tensor, "b r c h w"], target: Float[Tensor, "b c h w"]) -> None:
    """Write relu(references + target) to references, in place and in one pass over memory; both are channels-last."""
    from gaussian_enhancer.network.bfloat16_kernels import add_and_rectify

    reference_words = references.permute(0, 1, 3, 4, 2).view(torch.int16).numpy().view(np.uint16)
    with kernel_lock:
        add_and_rectify(reference_words, kernel_words(target))


def _pool_references(
    references: Float[Tensor, "b r c h w"], visibility: Float[Tensor, "b r 1 h w"]
) -> Float[Tensor, "b _ h w"]:
    """Mean features of the references, weighted by visibility, with the sum of visibilities / 3 as further channel."""
    if references.dtype == torch.bfloat16 and can_fuse(references, visibility):
        return _pool_compiled(references, visibility)
    visibility = visibility.to(references.dtype)
    total = visibility.sum(1)
    return torch.cat([weighted_sum(visibility, references) / total.clamp_min(1e-3), total / 3], dim=1)


def weighted_sum(
    weights: Float[Tensor, "b r 1 h w"], references: Float[Tensor, "b r c h w"]
) -> Float[Tensor, "b c h w"]:
    """Sum of weight x reference, one reference at a time, to avoid a tensor of all products."""
    total = weights[:, 0] * references[:, 0]
    for i in range(1, references.shape[1]):
        total = torch.addcmul(total, weights[:, i], references[:, i])
    return total


def _pool_compiled(
    references: Float[Tensor, "b r c h w"], visibility: Float[Tensor, "b r 1 h w"]
) -> Float[Tensor, "b _ h w"]:
    """Compiled version of `_pool_references`, in one pass over memory, where `can_fuse` holds."""
    from gaussian_enhancer.network.bfloat16_kernels import pool

    batch, count, channels, height, width = references.shape
    words = kernel_words(references.flatten(0, 1)).reshape(batch, count, height, width, channels)
    result = empty_features(batch, channels + 1, height, width)
    with kernel_lock:
        pool(words, plane(visibility[:, :, 0]), kernel_words(result))
    return result


class MeanFusion(nn.Module):
    """Mean of the references weighted by visibility, fused with the target by a convolution.

    Args:
        channels: number of feature channels.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.join = nn.Conv2d(2 * channels, channels, 3, padding=1)

    def forward(
        self,
        target: Float[Tensor, "b c h w"],
        references: Float[Tensor, "b r c h w"],
        visibility: Float[Tensor, "b r 1 h w"],
    ) -> tuple[Float[Tensor, "b c h w"], Float[Tensor, "b r 1 h w"]]:
        """Fuse features; also return each reference's weight at each pixel."""
        weights = visibility / visibility.sum(1, keepdim=True).clamp_min(1)
        mean = (weights.to(references.dtype) * references).sum(1)
        return target + self.join(torch.cat([target, mean], dim=1)), weights


class PairFusion(nn.Module):
    """The paper's fusion: a convolution over the features of the target and of exactly two references.

    fused = join(target, reference_1, reference_2), in this order; a missing reference is replaced by zeros.

    Args:
        channels: number of feature channels.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.join = nn.Conv2d(3 * channels, channels, 3, padding=1)

    def forward(
        self,
        target: Float[Tensor, "b c h w"],
        references: Float[Tensor, "b r c h w"],
        visibility: Float[Tensor, "b r 1 h w"],
    ) -> tuple[Float[Tensor, "b c h w"], Float[Tensor, "b r 1 h w"]]:
        """Fuse features; also return each reference's visibility.

        Raises:
            InputError: there are more than two references.
        """
        count = references.shape[1]
        if count > 2:
            raise InputError("references", f"are {count} for a fusion of two", "ask for 2, or choose another fusion")
        masked = [references[:, i] * visibility[:, i].to(references.dtype) for i in range(count)]
        masked += [torch.zeros_like(target)] * (2 - count)
        return self.join(torch.cat([target, *masked], dim=1)), visibility


@dataclass(frozen=True)
class Trust:
    """Choice of fusion by trust; see `TrustFusion`."""

    heads: int = 4
    pooled: bool = False

    def build(self, channels: int) -> nn.Module:
        """Build the module for features with this number of channels."""
        return TrustFusion(channels, self.heads, self.pooled)


@dataclass(frozen=True)
class Mean:
    """Choice of fusion by visibility only; see `MeanFusion`."""

    def build(self, channels: int) -> nn.Module:
        """Build the module for features with this number of channels."""
        return MeanFusion(channels)


@dataclass(frozen=True)
class Pair:
    """Choice of fusion of exactly two references in a fixed order; see `PairFusion`."""

    def build(self, channels: int) -> nn.Module:
        """Build the module for features with this number of channels."""
        return PairFusion(channels)
