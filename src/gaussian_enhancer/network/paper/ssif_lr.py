"""The paper's SSIF-LR (algorithm 3): fusion at 1/4, 1/2 and 1 of the render's resolution.

Axes: b batch, r references, c channels, h height, w width; i and j half of a scale's height and width.
"""

from collections.abc import Sequence
from typing import cast

from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.decode import Decoder
from gaussian_enhancer.network.deform import Deformable
from gaussian_enhancer.network.initialisation import zero_initialise
from gaussian_enhancer.network.network import CachesReferences
from gaussian_enhancer.network.paper.stages import (
    DeformableConv,
    FeatureFusion,
    ImageEncoder,
    LearnedCombine,
    depth_planes,
    halved_visibility,
)
from gaussian_enhancer.network.pyramid import three_scales
from gaussian_enhancer.network.stem import Choice
from gaussian_enhancer.types import NetworkInput

FACTORS = (4, 2, 1)


class PaperSSIFLR(CachesReferences):
    """GaussianEnhancer++'s SSIF-LR (algorithm 3), coarse to fine.

    At each scale s: F_fused = DeformableConv(F[G t-1], F[L], F[G t+1]) and T = Decoder(F_fused (+) F[D]). At 1/4,
    E = DeformableConv(T, F[G t-1], F[G t+1]). At 1/2, E = Combine(T, up2 E(1/4)). At 1, E = Fuse(T, up4 E(1/4),
    up2 E(1/2)). No scale shares weights with another. Untrained, every scale returns its render.

    Args:
        widths: channels of each scale's decoder at 1/2, 1/4, 1/8, ... of the scale's resolution.
        blocks: number of residual blocks at each of these levels.
        encoder_blocks: number of residual blocks of the encoders.
        refine: the deformable convolution.
    """

    def __init__(
        self,
        widths: Sequence[int] = (32, 64, 96),
        blocks: Sequence[int] = (2, 2, 3),
        encoder_blocks: int = 1,
        refine: Choice = Deformable(reach=None),  # noqa: B008  (frozen values)
    ) -> None:
        super().__init__()
        self.describe(locals())
        widths, blocks = [int(c) for c in widths], [int(n) for n in blocks]
        self.stride = FACTORS[0] * 2 ** max(len(widths), 2)
        self.scales = nn.ModuleList(Scale(widths, blocks, encoder_blocks, refine) for _ in FACTORS)
        self.encode_coarsest = ImageEncoder(3, widths[0], encoder_blocks)
        self.align_again = DeformableConv(widths[0], refine, 12)
        zero_initialise(self.align_again.join)
        self.combine = LearnedCombine(1, widths[0])
        self.fuse = LearnedCombine(2, widths[0])

    def encode(self, views: NetworkInput) -> tuple[Float[Tensor, "b r c _ _"], ...]:
        """Features of the references at each scale."""
        return self._encode_scales(three_scales(views, self.stride))

    def _encode_scales(self, pyramid: Sequence[NetworkInput]) -> tuple[Float[Tensor, "b r c _ _"], ...]:
        return tuple(
            self._scale(k).encode_reference.encode_each(scale_views.references - 0.5)
            for k, scale_views in enumerate(pyramid)
        )

    def stages(
        self, views: NetworkInput, encoded: tuple[Float[Tensor, "b r c _ _"], ...] | None = None
    ) -> tuple[Float[Tensor, "b 3 _ _"], ...]:
        """E at 1/4, 1/2 and full resolution, the sides of coarser ones rounded up; from at most two references."""
        height, width = views.render.shape[-2:]
        pyramid = three_scales(views, self.stride)
        references = self._encode_scales(pyramid) if encoded is None else encoded
        quarter = self._scale(0)(pyramid[0], references[0])
        quarter = self._realign_coarsest(quarter, pyramid[0], references[0])
        half = self.combine(self._scale(1)(pyramid[1], references[1]), quarter)
        full = self.fuse(self._scale(2)(pyramid[2], references[2]), quarter, half)
        scales = zip((quarter, half, full), FACTORS, strict=True)
        return tuple(image[..., : -(-height // factor), : -(-width // factor)] for image, factor in scales)

    def _realign_coarsest(
        self, image: Float[Tensor, "b 3 h w"], views: NetworkInput, references: Float[Tensor, "b r c i j"]
    ) -> Float[Tensor, "b 3 h w"]:
        """E(1/4) = DeformableConv(T(1/4), F[G t-1], F[G t+1]), interpreted as a change of T."""
        target = self.encode_coarsest(image - 0.5)
        change = self.align_again(target, references.to(target.dtype), halved_visibility(views))
        return image + nn.functional.pixel_shuffle(change, 2).to(image.dtype)

    def _scale(self, level: int) -> "Scale":
        return cast(Scale, self.scales[level])


class Scale(nn.Module):
    """T = Decoder(DeformableConv(F[G t-1], F[L], F[G t+1]) (+) F[D]) at one scale, with its own weights.

    Args:
        widths: channels of the decoder.
        blocks: number of residual blocks of the decoder.
        encoder_blocks: number of residual blocks of the encoders.
        refine: the deformable convolution.
    """

    def __init__(self, widths: Sequence[int], blocks: Sequence[int], encoder_blocks: int, refine: Choice) -> None:
        super().__init__()
        channels = widths[0]
        self.encode_reference = ImageEncoder(3, channels, encoder_blocks)
        self.encode_target = ImageEncoder(3, channels, encoder_blocks)
        self.encode_depth = ImageEncoder(2, channels, encoder_blocks)
        self.fuse = DeformableConv(channels, refine, channels)
        self.join_depth = FeatureFusion(channels, 2)
        self.decode = Decoder(widths, blocks, 3)

    def forward(self, views: NetworkInput, references: Float[Tensor, "b r c i j"]) -> Float[Tensor, "b 3 h w"]:
        """Compute T of this scale.

        Args:
            views: network input at this scale.
            references: features of the references at this scale.
        """
        target = self.encode_target(views.render - 0.5)
        depth = self.encode_depth(depth_planes(views))
        fused = self.fuse(target, references.to(target.dtype), halved_visibility(views))
        return views.render + self.decode(self.join_depth(fused, depth)).to(views.render.dtype)
