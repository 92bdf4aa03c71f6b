"""SSIF-LR, the paper's super spatial information fusion at the render's resolution: SIF at 1/4, 1/2 and 1.

Axes: b batch, r references, c channels, h height, w width, i and j half of a scale's height and width.
"""

import dataclasses
from collections.abc import Sequence
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.network.combine import Combine, Combined
from gaussian_enhancer.network.decode import Decoder
from gaussian_enhancer.network.deform import Unrefined
from gaussian_enhancer.network.depth_modulation import DepthModulated
from gaussian_enhancer.network.fuse import Trust
from gaussian_enhancer.network.network import CachesReferences
from gaussian_enhancer.network.output_head import Gated, Output
from gaussian_enhancer.network.pyramid import three_scales
from gaussian_enhancer.network.stem import Choice, Gather
from gaussian_enhancer.types import NetworkInput

FACTORS = (4, 2, 1)


class SSIFLR(CachesReferences):
    """GaussianEnhancer++'s SSIF-LR (algorithm 3), coarse to fine.

    At each scale T = output(decode(gather(views))). At 1/4, references are aligned again, to T in place of the
    render: E = output(settle(gather(T))). E(1/2) = combine(T(1/2), E(1/4)), E(1) = combine(T(1), E(1/4), E(1/2)).
    Untrained, every scale returns its render. Differences from the paper: the fusions of `gather`, the terms of
    `compose`, and that coarser scales pass on their change and features instead of their image.

    Args:
        widths: channels at 1/2, 1/4, 1/8, ... of the resolution in the finest scale's decoder. The decoders of the
            coarser scales, whose images are small, have the first two levels only.
        blocks: number of residual blocks at each of these levels; half as many, rounded up, in the coarser scales'
            decoders.
        encoder_blocks: number of residual blocks of the encoders.
        refine: learned alignment of the references' features.
        fusion: fusion of references with the target.
        modulation: modulation of the fused features by depth.
        combine: combination of scales.
        output: output head.
        reference_renders: use the splat's renders of the references' views if they are known.
        share: use the same weights of `gather` at all scales.
    """

    def __init__(
        self,
        widths: Sequence[int] = (32, 64, 96),
        blocks: Sequence[int] = (2, 2, 3),
        encoder_blocks: int = 1,
        refine: Choice = Unrefined(),  # noqa: B008  (frozen values)
        fusion: Choice = Trust(pooled=True),  # noqa: B008
        modulation: Choice = DepthModulated(),  # noqa: B008
        combine: Combine = Combined(),  # noqa: B008
        output: Output = Gated(),  # noqa: B008
        reference_renders: bool = True,
        share: bool = True,
    ) -> None:
        super().__init__()
        self.describe(locals())
        widths, blocks = [int(c) for c in widths], [int(n) for n in blocks]
        self.output = output
        coarse_blocks = [(n + 1) // 2 for n in blocks[:2]]
        self.stride = max(4 * FACTORS[0], 2 ** len(widths))
        self.gather = nn.ModuleList(
            Gather(widths[0], encoder_blocks, refine, fusion, modulation, reference_renders)
            for _ in (FACTORS[:1] if share else FACTORS)
        )
        passed_on = output.outputs + combine.handed
        self.decode = nn.ModuleList(
            [
                Decoder(widths[:2], coarse_blocks, output.outputs),
                Decoder(widths[:2], coarse_blocks, passed_on),
                Decoder(widths, blocks, output.outputs),
            ]
        )
        self.settle = Decoder(widths[:1], blocks[:1], passed_on)
        self.combine = nn.ModuleList(combine.build(widths[0], coarser) for coarser in (1, 2))

    def encode(self, views: NetworkInput) -> tuple[Float[Tensor, "b r c _ _"], ...]:
        """Features of the references at each scale; `forward` can reuse them if references are not warped."""
        return tuple(
            self._gather(level).encode(scale_views)
            for level, scale_views in enumerate(three_scales(views, self.stride))
        )

    def stages(
        self, views: NetworkInput, encoded: tuple[Float[Tensor, "b r c _ _"], ...] | None = None
    ) -> tuple[Float[Tensor, "b 3 _ _"], ...]:
        """Enhanced images at 1/4, 1/2 and full resolution; the sides of coarser ones are rounded up."""
        sides = views.render.shape[-2:]
        coarser: list[Tensor] = []
        images: list[Tensor] = []
        for level, (factor, scale_views) in enumerate(zip(FACTORS, three_scales(views, self.stride), strict=True)):
            reference_features = self._gather(level).encode(scale_views) if encoded is None else encoded[level]
            image, passed_on = self._scale(level, scale_views, reference_features, self.decode[level])
            if level == 0:
                image, passed_on = self._scale(
                    level, dataclasses.replace(scale_views, render=image), reference_features, self.settle
                )
            else:
                image = self.combine[level - 1](image, scale_views.render, coarser)
            coarser.append(torch.cat([image - scale_views.render, passed_on.to(image.dtype)], dim=1))
            images.append(image[..., : -(-sides[0] // factor), : -(-sides[1] // factor)])
        return tuple(images)

    def _gather(self, level: int) -> Gather:
        return cast(Gather, self.gather[min(level, len(self.gather) - 1)])

    def _scale(
        self, level: int, views: NetworkInput, encoded: Float[Tensor, "b r c i j"], decode: nn.Module
    ) -> tuple[Float[Tensor, "b 3 h w"], Float[Tensor, "b _ h w"]]:
        """Compute one scale: its image, and the features that its decoder passes to finer scales."""
        features, trust = self._gather(level)(views, encoded)
        decoded, outputs = decode(features), self.output.outputs
        return self.output(decoded[:, :outputs], views, trust), decoded[:, outputs:]
