"""SIF, the paper's spatial information fusion network: render, references and depth to an enhanced view.

Axes: b batch, r references, h height, w width.
"""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from gaussian_enhancer.enhance.decode import Decoder
from gaussian_enhancer.enhance.deform import Unrefined
from gaussian_enhancer.enhance.encode import Encoder
from gaussian_enhancer.enhance.fuse import Trust
from gaussian_enhancer.enhance.modulate import DepthModulated
from gaussian_enhancer.types import Views


@runtime_checkable
class Choice(Protocol):
    """A frozen dataclass of plain values that names one way of doing a stage."""

    def build(self, channels: int) -> nn.Module:
        """The stage for features of so many channels."""
        ...


class SIF(nn.Module):
    """Enhanced = render + confidence x residual + gate x sum_i trust_i (reference_i - render).

    H = fuse(F[render], align(F[reference_i], F[render])), E = modulate(H, depth), and the decoder reads residual,
    confidence and gate off E. Residual and gate are zero at birth: the untrained network returns the render bit for
    bit. Confidence lets it hold back where it is unsure; the gated term hands through sharp pixels of references
    without having to encode them. GaussianEnhancer's SIF, with a decoder after NAFNet and trust in place of a
    convolution over a fixed pair of references.

    Args:
        widths: channels at 1/2, 1/4, 1/8, ... of the resolution.
        blocks: residual blocks at each of these levels.
        encoder_blocks: residual blocks of the encoders.
        refine: learned alignment of the references' features.
        fusion: how references join the target.
        modulation: how depth acts.
    """

    def __init__(
        self,
        widths: Sequence[int] = (32, 64, 96),
        blocks: Sequence[int] = (2, 2, 3),
        encoder_blocks: int = 1,
        refine: Choice = Unrefined(),  # noqa: B008  (frozen values)
        fusion: Choice = Trust(),  # noqa: B008
        modulation: Choice = DepthModulated(),  # noqa: B008
    ) -> None:
        super().__init__()
        self.widths, self.blocks = tuple(int(c) for c in widths), tuple(int(n) for n in blocks)
        self.encoder_blocks = encoder_blocks
        self.choices = {"refine": refine, "fusion": fusion, "modulation": modulation}
        channels = self.widths[0]
        self.encode_render = Encoder(channels, encoder_blocks)
        self.encode_reference = Encoder(channels, encoder_blocks)
        self.align = refine.build(channels)
        self.fuse = fusion.build(channels)
        self.modulate = modulation.build(channels)
        self.decode = Decoder(self.widths, self.blocks, outputs=5)

    @property
    def stride(self) -> int:
        """Images are padded to multiples of this; tiles start at multiples of it."""
        return 2 ** max(len(self.widths), 2)

    def forward(self, views: Views) -> Float[Tensor, "b 3 h w"]:
        """Enhance renders of any size with any number of references, none included."""
        height, width = views.render.shape[-2:]
        views = _padded(views, -height % self.stride, -width % self.stride)
        render, references, visibility = views.render, views.references, views.visibility
        alpha = torch.ones_like(render[:, :1]) if views.alpha is None else views.alpha
        target = self.encode_render(render, alpha)
        encoded = self._encoded(references, visibility, target)
        half = F.avg_pool2d(visibility.flatten(0, 1), 2).unflatten(0, visibility.shape[:2])
        fused, trust = self.fuse(target, encoded, half)
        decoded = self.decode(self.modulate(fused, views.depth, views.depth_unit)).to(render.dtype)
        enhanced = render + torch.sigmoid(decoded[:, 3:4]) * decoded[:, :3]
        if references.shape[1]:
            weight = F.interpolate(trust.flatten(0, 1).to(render.dtype), scale_factor=2, mode="bilinear")
            weight = weight.unflatten(0, visibility.shape[:2]) * (visibility > 0)
            enhanced = enhanced + decoded[:, 4:] * (weight * (references - render[:, None])).sum(1)
        return enhanced[..., :height, :width]

    def _encoded(
        self,
        references: Float[Tensor, "b r 3 h w"],
        visibility: Float[Tensor, "b r 1 h w"],
        target: Float[Tensor, "b c i j"],
    ) -> Float[Tensor, "b r c i j"]:
        """Features of the references, aligned to the target's."""
        batch, count = references.shape[:2]
        if count == 0:
            return target.new_zeros(batch, 0, *target.shape[1:])
        features = self.encode_reference(references.flatten(0, 1), visibility.flatten(0, 1))
        features = self.align(features, target.repeat_interleave(count, dim=0))
        return features.unflatten(0, (batch, count))


def _padded(views: Views, bottom: int, right: int) -> Views:
    """Views whose last row and column are repeated."""
    if bottom == 0 and right == 0:
        return views

    def grown(image: Tensor | None) -> Tensor | None:
        if image is None:
            return None
        flat = image.reshape(-1, *image.shape[-3:]) if image.dim() == 5 else image
        flat = (
            F.pad(flat, (0, right, 0, bottom), mode="replicate")
            if flat.shape[0]
            else flat.new_zeros(0, flat.shape[1], flat.shape[2] + bottom, flat.shape[3] + right)
        )
        return flat.reshape(*image.shape[:-2], *flat.shape[-2:])

    return Views(
        grown(views.render),  # type: ignore[arg-type]
        grown(views.references),  # type: ignore[arg-type]
        grown(views.visibility),  # type: ignore[arg-type]
        grown(views.depth),
        grown(views.alpha),
        views.depth_unit,
    )
