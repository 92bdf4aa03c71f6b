"""Stem of the fusion networks: converts the network input to one set of features.

Axes: b batch, r references, c channels, h height, w width (multiples of the stride), i = h / 2, j = w / 2.
"""

from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.bfloat16 import can_fuse, empty_features, kernel_lock, kernel_words, plane
from gaussian_enhancer.network.encode import COLOURS, Encoder, limit_colours
from gaussian_enhancer.network.halving import halve
from gaussian_enhancer.types import NetworkInput


@runtime_checkable
class Choice(Protocol):
    """A frozen dataclass of plain values that selects an implementation of a stage."""

    def build(self, channels: int) -> nn.Module:
        """Build the module for features with this number of channels."""
        ...


class Gather(nn.Module):
    """H = fuse(F[render], align(F[reference_i], F[render])), E = modulate(H, depth), at half resolution.

    A reference's features depend only on that reference. If references are not warped, the result of `encode` can
    therefore be reused for many targets.

    Args:
        channels: number of feature channels.
        encoder_blocks: number of residual blocks of the encoders.
        refine: learned alignment of the references' features.
        fusion: fusion of references with the target.
        modulation: modulation of the fused features by depth.
        reference_renders: use the splat's renders of the references' views if they are known.
    """

    def __init__(
        self,
        channels: int,
        encoder_blocks: int,
        refine: Choice,
        fusion: Choice,
        modulation: Choice,
        reference_renders: bool,
    ) -> None:
        super().__init__()
        self.reference_renders = reference_renders
        self.encode_render = Encoder(channels, encoder_blocks)
        self.encode_reference = Encoder(channels, encoder_blocks, planes=8 if reference_renders else 4)
        self.align = refine.build(channels)
        self.fuse = fusion.build(channels)
        self.modulate = modulation.build(channels)

    def encode(self, views: NetworkInput) -> Float[Tensor, "b r c i j"]:
        """Features of the references, not yet aligned to the target."""
        references, visibility = views.references, views.visibility
        if references.shape[1] == 0:
            height, width = references.shape[-2:]
            return references.new_zeros(len(references), 0, self.encode_render.channels, height // 2, width // 2)
        if self.reference_renders and can_fuse(references, visibility, views.reference_renders):
            return self.encode_reference.features(_pack_references(views)).unflatten(0, references.shape[:2])
        references, extra_planes = limit_colours(references), None
        if self.reference_renders:
            renders = views.reference_renders
            residual = torch.zeros_like(references) if renders is None else references - limit_colours(renders)
            flag = torch.full_like(visibility, float(renders is not None))
            extra_planes = torch.cat([residual, flag], dim=2).flatten(0, 1)
        features = self.encode_reference(references.flatten(0, 1), visibility.flatten(0, 1), extra_planes)
        return features.unflatten(0, references.shape[:2])

    def forward(
        self, views: NetworkInput, encoded: Float[Tensor, "b r c i j"] | None = None
    ) -> tuple[Float[Tensor, "b c i j"], Float[Tensor, "b r 1 i j"]]:
        """Fused, depth-modulated features, and the weight of each reference at each pixel.

        Args:
            views: input of the network.
            encoded: result of `encode` for these references; None computes it.
        """
        alpha = torch.ones_like(views.render[:, :1]) if views.alpha is None else views.alpha
        target = self.encode_render(views.render, alpha)
        features = self.encode(views) if encoded is None else encoded.to(target.dtype)
        if features.shape[1]:
            features = self.align(features, target)
        visibility = halve(views.visibility)
        fused, trust = self.fuse(target, features, visibility)
        return self.modulate(fused, views.depth, views.depth_unit), trust


def _pack_references(views: NetworkInput) -> Float[Tensor, "n 32 i j"]:
    """Input of the reference encoder, pixel-unshuffled, in one pass over memory."""
    from gaussian_enhancer.network.bfloat16_kernels import pack_references

    photos, visibility = views.references.flatten(0, 1), views.visibility.flatten(0, 1)
    has_renders = views.reference_renders is not None
    renders = photos if views.reference_renders is None else views.reference_renders.flatten(0, 1)
    result = empty_features(len(photos), 32, photos.shape[-2] // 2, photos.shape[-1] // 2)
    images = plane(photos), plane(renders), plane(visibility)
    with kernel_lock:
        pack_references(*images, np.float32(has_renders), *map(np.float32, COLOURS), kernel_words(result, np.uint32))
    return result
