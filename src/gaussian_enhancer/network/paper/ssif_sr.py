"""The paper's SSIF-SR (algorithm 2): from the render's resolution to 4 times that resolution, via 2 times.

Axes: b batch, r references, c channels, h height, w width, H = 4 h, W = 4 w; i and j half of a scale's sides.
"""

from collections.abc import Sequence
from typing import cast

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.decode import Decoder
from gaussian_enhancer.network.deform import Deformable
from gaussian_enhancer.network.halving import halve
from gaussian_enhancer.network.network import CachesReferences
from gaussian_enhancer.network.paper.stages import (
    ADJACENT,
    DeformableConv,
    FeatureFusion,
    ImageEncoder,
    LearnedCombine,
    adjacent_features,
    depth_planes,
    halved_visibility,
)
from gaussian_enhancer.network.pyramid import pad_to_stride, upsample_bicubic
from gaussian_enhancer.network.ssif_sr import fine_references
from gaussian_enhancer.network.stem import Choice
from gaussian_enhancer.types import NetworkInput

SCALES = (1, 2, 4)


class PaperSSIFSR(CachesReferences):
    """GaussianEnhancer++'s SSIF-SR (algorithm 2), coarse to fine.

    F_fused = DeformableConv(F[G t-1], F[L], F[G t+1]) and F[D] are computed once, at the render's resolution, and
    used again at 2 and 4 times it. At each scale s: T = Decoder(F_fused (+) F[D] (+) F[HG t-1] (+) F[HG t+1]). The last
    two are encoded at that scale, separately and without alignment: the text aligns low-resolution references only.
    S(1) = T(1), S(2) = Combine(T(2), up2 S(1)), S(4) = Combine(T(4), up4 S(1), up2 S(2)). Scales share F_fused and
    F[D], but no weights. Untrained, every scale returns the render, bicubically upsampled.

    Args:
        widths: channels of each scale's decoder at 1/2, 1/4, 1/8, ... of the scale's resolution.
        blocks: number of residual blocks at each of these levels.
        encoder_blocks: number of residual blocks of the encoders.
        refine: the deformable convolution.
        buffer: keep F_fused and F[D] for the finer scales. Without it they are computed again at each of the three
            scales, which changes the cost but not the result.
    """

    scale = 4

    def __init__(
        self,
        widths: Sequence[int] = (32, 64, 96),
        blocks: Sequence[int] = (2, 2, 3),
        encoder_blocks: int = 1,
        refine: Choice = Deformable(reach=None),  # noqa: B008  (frozen values)
        buffer: bool = True,
    ) -> None:
        super().__init__()
        self.describe(locals())
        widths, blocks = [int(c) for c in widths], [int(n) for n in blocks]
        channels = widths[0]
        self.stride, self.buffer = 2 ** max(len(widths), 2), buffer
        self.encode_reference = ImageEncoder(3, channels, encoder_blocks)
        self.encode_target = ImageEncoder(3, channels, encoder_blocks)
        self.encode_depth = ImageEncoder(2, channels, encoder_blocks)
        self.encode_fine = nn.ModuleList(ImageEncoder(3, channels, encoder_blocks) for _ in SCALES)
        self.fuse = DeformableConv(channels, refine, channels)
        self.join = nn.ModuleList(FeatureFusion(channels, 2 + ADJACENT) for _ in SCALES)
        self.decode = nn.ModuleList(Decoder(widths, blocks, 3) for _ in SCALES)
        self.combine = nn.ModuleList(LearnedCombine(coarser, channels) for coarser in (1, 2))

    def encode(self, views: NetworkInput) -> tuple[Float[Tensor, "b r c _ _"], ...]:
        """Features of the references: F[G] at 1x, then F[HG] at 1x, 2x and 4x."""
        views = pad_to_stride(views, self.stride)
        finest = fine_references(views)[0].to(views.render)
        half = halve(finest)
        fine = (
            cast(ImageEncoder, encoder).encode_each(photos - 0.5)
            for encoder, photos in zip(self.encode_fine, (halve(half), half, finest), strict=True)
        )
        return self.encode_reference.encode_each(views.references - 0.5), *fine

    def stages(
        self, views: NetworkInput, encoded: tuple[Float[Tensor, "b r c _ _"], ...] | None = None
    ) -> tuple[Float[Tensor, "b 3 _ _"], ...]:
        """S at 1, 2 and 4 times the render's size, from at most two references; missing fine references are zero."""
        height, width = views.render.shape[-2:]
        references, *fine = self.encode(views) if encoded is None else encoded
        views = pad_to_stride(views, self.stride)
        buffered: tuple[Tensor, Tensor] | None = None
        images: list[Tensor] = []
        for level in range(len(SCALES)):
            if buffered is None or not self.buffer:
                buffered = self._fuse(views, references)
            image = self._decode(level, views, buffered, fine[level])
            images.append(self.combine[level - 1](image, *images) if level else image)
        scales = zip(images, SCALES, strict=True)
        return tuple(image[..., : scale * height, : scale * width] for image, scale in scales)

    def _fuse(
        self, views: NetworkInput, references: Float[Tensor, "b r c i j"]
    ) -> tuple[Float[Tensor, "b c i j"], Float[Tensor, "b c i j"]]:
        """F_fused and F[D], the features that are shared by the scales."""
        target = self.encode_target(views.render - 0.5)
        fused = self.fuse(target, references.to(target.dtype), halved_visibility(views))
        return fused, self.encode_depth(depth_planes(views))

    def _decode(
        self,
        level: int,
        views: NetworkInput,
        fused_features: tuple[Float[Tensor, "b c _ _"], Float[Tensor, "b c _ _"]],
        fine: Float[Tensor, "b r c i j"],
    ) -> Float[Tensor, "b 3 _ _"]:
        """Compute T of a scale."""
        scale = SCALES[level]
        visibility = halved_visibility(views)[:, : fine.shape[1]]
        visibility = visibility.repeat_interleave(scale, dim=-2).repeat_interleave(scale, dim=-1)
        shared = [
            tensor if scale == 1 else F.interpolate(tensor, scale_factor=scale, mode="bilinear")
            for tensor in fused_features
        ]
        features = self.join[level](*shared, *adjacent_features(fine.to(shared[0].dtype), visibility))
        return upsample_bicubic(views.render, scale) + self.decode[level](features).to(views.render.dtype)
