"""SSIF-SR, the paper's super spatial information fusion to 4 times the render's resolution.

Axes: b batch, r references, c channels, h height, w width, H = 4 h, W = 4 w; i and j half of a scale's sides.
"""

import dataclasses
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.enhance.block import Block
from gaussian_enhancer.enhance.compose import Gated, Output
from gaussian_enhancer.enhance.decode import Decoder
from gaussian_enhancer.enhance.deform import Unrefined
from gaussian_enhancer.enhance.encode import Encoder
from gaussian_enhancer.enhance.fuse import Trust
from gaussian_enhancer.enhance.gather import Choice, Gather
from gaussian_enhancer.enhance.modulate import DepthModulated
from gaussian_enhancer.enhance.network import Network
from gaussian_enhancer.enhance.pyramid import enlarged, padded
from gaussian_enhancer.types import Views

FINER = (2, 4)


class SSIFSR(Network):
    """GaussianEnhancer++'s SSIF-SR (algorithm 2): what is found at 1x once, refined by fine references at 2x and 4x.

    S1 = output(T1), T1 and features from decode(gather(views)), all of it at the render's resolution. Then at s = 2, 4
    S_s = output(T_s) over base_s, T_s from the last scale's features, twice enlarged, fused with the fine
    references', where base_2 = up2(S1) and base_4 = up4(S1) + up2(S2 - up2(S1)), bicubically. A fine reference's part
    in `compose` that no exposure changes is what its own half size cannot hold. Untrained, every scale returns its
    enlarged render. What differs from the paper: the U-Net runs once, at 1x; finer scales are light, at half their
    resolution; coarser images are combined by adding, not by convolution, so that no scale can lose them.

    Args:
        widths: channels at 1/2, 1/4, 1/8, ... of the render's resolution; the first are also the channels of the scale
            2, and halved those of the scale 4.
        blocks: residual blocks at each of these levels; the first are also those of the finer scales.
        encoder_blocks: residual blocks of the encoders at 1x.
        refine: learned alignment of the references' features at 1x.
        fusion: how references join the target, at each scale.
        modulation: how depth acts.
        output: how decoded values become an image, at each scale.
        reference_renders: read the splat's renders of the references' views, where they are known.
    """

    scale = 4

    def __init__(
        self,
        widths: Sequence[int] = (32, 64, 96),
        blocks: Sequence[int] = (2, 2, 3),
        encoder_blocks: int = 1,
        refine: Choice = Unrefined(),  # noqa: B008  (frozen values)
        fusion: Choice = Trust(),  # noqa: B008
        modulation: Choice = DepthModulated(),  # noqa: B008
        output: Output = Gated(),  # noqa: B008
        reference_renders: bool = True,
    ) -> None:
        super().__init__()
        widths, blocks = [int(c) for c in widths], [int(n) for n in blocks]
        self.design = {
            "network": "SSIFSR",
            "widths": widths,
            "blocks": blocks,
            "encoder_blocks": encoder_blocks,
            "refine": refine,
            "fusion": fusion,
            "modulation": modulation,
            "output": output,
            "reference_renders": reference_renders,
        }
        self.stride = 2 ** max(len(widths), 2)
        self.gather = Gather(widths[0], encoder_blocks, refine, fusion, modulation, reference_renders)
        self.decode = Decoder(widths, blocks, output.outputs)
        self.grow = nn.ModuleList([nn.Conv2d(widths[0], 4 * widths[0], 1), nn.Conv2d(widths[0], 2 * widths[0], 1)])
        sizes = widths[0], widths[0] // 2
        self.finer = nn.ModuleList(FineScale(channels, blocks[0], fusion, output.outputs) for channels in sizes)
        self.output = output

    def encode(self, views: Views) -> tuple[Float[Tensor, "b r c _ _"], ...]:
        """Features of the references at each scale, for `forward` to use again where they are not warped."""
        views = padded(views, self.stride)
        return self._encode(views, fine_scales(views))

    def forward(
        self, views: Views, encoded: tuple[Float[Tensor, "b r c _ _"], ...] | None = None
    ) -> Float[Tensor, "b 3 H W"]:
        """Enhance renders of any size with any number of references, none included.

        Args:
            views: what is known of the targets; without fine references, detail comes from the render alone.
            encoded: what `encode` gave for these references.
        """
        return self.stages(views, encoded)[-1]

    def stages(
        self, views: Views, encoded: tuple[Float[Tensor, "b r c _ _"], ...] | None = None
    ) -> tuple[Float[Tensor, "b 3 _ _"], ...]:
        """Enhanced images of 1, 2 and 4 times the render's size."""
        height, width = views.render.shape[-2:]
        views = padded(views, self.stride)
        fine = fine_scales(views)
        known = self._encode(views, fine) if encoded is None else encoded
        fused, trust = self.gather(views, known[0])
        features = self.decode.features(fused)
        images = [self.output(self.decode.outputs(features), views, trust)]
        for level, seen in enumerate(fine):
            base = enlarged(images[0], FINER[level])
            if level:
                base = base + enlarged(images[1] - enlarged(images[0], 2), 2)
            features = F.pixel_shuffle(self.grow[level](features), 2)
            features, decoded, trust = self.finer[level](features, known[1 + level], seen.visibility)
            images.append(self.output(decoded, dataclasses.replace(seen, render=base), trust))
        return tuple(image[..., : n * height, : n * width] for n, image in zip((1, *FINER), images, strict=True))

    def _encode(self, views: Views, fine: Sequence[Views]) -> tuple[Tensor, ...]:
        finer = [scale.encode(seen) for scale, seen in zip(self.finer, fine, strict=True)]  # type: ignore[operator]
        return (self.gather.encode(views), *finer)


class FineScale(nn.Module):
    """One of the finer scales: fine references' features join the coarser scale's, at half the scale's resolution.

    Args:
        channels: of the features.
        blocks: residual blocks.
        fusion: how references join the target.
        outputs: channels that are decoded.
    """

    def __init__(self, channels: int, blocks: int, fusion: Choice, outputs: int) -> None:
        super().__init__()
        self.encode_reference = Encoder(channels, 0)
        self.fuse = fusion.build(channels)
        self.blocks = nn.Sequential(*(Block(channels) for _ in range(blocks)))
        self.head = nn.Conv2d(channels, 4 * outputs, 3, padding=1)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)  # type: ignore[arg-type]

    def encode(self, views: Views) -> Float[Tensor, "b r c i j"]:
        """Features of the references of this scale."""
        references, visibility = views.references, views.visibility
        if references.shape[1] == 0:
            height, width = references.shape[-2:]
            return references.new_zeros(len(references), 0, self.head.in_channels, height // 2, width // 2)
        features = self.encode_reference(references.flatten(0, 1), visibility.flatten(0, 1))
        return features.unflatten(0, references.shape[:2])

    def forward(
        self,
        features: Float[Tensor, "b c i j"],
        encoded: Float[Tensor, "b r c i j"],
        visibility: Float[Tensor, "b r 1 h w"],
    ) -> tuple[Float[Tensor, "b c i j"], Float[Tensor, "b o h w"], Float[Tensor, "b r 1 i j"]]:
        """Features for the next scale, decoded values, and how far each reference was trusted.

        Args:
            features: the coarser scale's, on this scale's grid.
            encoded: of the references, from `encode`.
            visibility: of the references on the scale's own grid.
        """
        seen = F.avg_pool2d(visibility.flatten(0, 1), 2).unflatten(0, visibility.shape[:2])
        fused, trust = self.fuse(features, encoded.to(features.dtype), seen)
        features = self.blocks(fused)
        return features, F.pixel_shuffle(self.head(features), 2), trust


def fine_scales(views: Views) -> tuple[Views, ...]:
    """What is seen at 2 and at 4 times the render's size: fine references, their visibility and their soft versions.

    A reference's ``reference_renders`` are what its own half size holds of it, bicubically enlarged. Where it is not
    visible, its pixels are the enlarged render's, so that no border of visibility is taken for detail. The render
    itself is enlarged. Without fine references there are no references.

    Args:
        views: padded, at the render's size.
    """
    fine, visibility = views.fine_references, views.visibility
    if fine is None:
        fine = views.render.new_zeros(len(views.render), 0, 3, *(4 * side for side in views.render.shape[-2:]))
        visibility = visibility[:, :0]
    seen = [visibility if n == 1 else _repeated(visibility, n) for n in (1, *FINER)]
    fine = torch.where(seen[2] > 0, fine, enlarged(views.render, 4)[:, None])
    images = [_resampled(fine, 1 / 4), _resampled(fine, 1 / 2), fine]
    return tuple(
        Views(enlarged(views.render, n), images[k], seen[k], reference_renders=_resampled(images[k - 1], 2))
        for k, n in enumerate(FINER, start=1)
    )


def _repeated(plane: Float[Tensor, "b r 1 h w"], times: int) -> Float[Tensor, "b r 1 _ _"]:
    return plane.repeat_interleave(times, dim=-2).repeat_interleave(times, dim=-1)


def _resampled(images: Float[Tensor, "b r 3 _ _"], factor: float) -> Float[Tensor, "b r 3 _ _"]:
    """Averaged over squares of pixels, or bicubically enlarged."""
    if images.shape[1] == 0:
        return images.new_zeros(*images.shape[:-2], *(round(factor * side) for side in images.shape[-2:]))
    flat = images.flatten(0, 1)
    flat = enlarged(flat, round(factor)) if factor > 1 else F.avg_pool2d(flat, round(1 / factor))
    return flat.unflatten(0, images.shape[:2])
