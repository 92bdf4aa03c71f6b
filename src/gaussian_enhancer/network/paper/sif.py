"""The paper's SIF: view fusion V, then depth modulation S (equations 3 and 4).

Axes: b batch, r references, c channels, h height, w width, i = h / 2, j = w / 2.
"""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.network.decode import Decoder
from gaussian_enhancer.network.deform import Deformable
from gaussian_enhancer.network.depth_modulation import DepthModulation
from gaussian_enhancer.network.network import CachesReferences
from gaussian_enhancer.network.paper.stages import DeformableConv, ImageEncoder, halved_visibility
from gaussian_enhancer.network.pyramid import pad_to_stride
from gaussian_enhancer.network.stem import Choice
from gaussian_enhancer.types import NetworkInput


class PaperSIF(CachesReferences):
    """GaussianEnhancer's SIF: H = V(G[t-1], L, G[t+1]), E = S(H, D).

    H is an image, decoded from the fused features before depth is used. S encodes H, scales and shifts its features by
    functions of depth, and decodes E. Untrained, H and E are the render.

    Args:
        widths: channels of the decoder of V at 1/2, 1/4, 1/8, ... of the resolution.
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
        self.stride = 2 ** max(len(widths), 2)
        self.encode_reference = ImageEncoder(3, widths[0], encoder_blocks)
        self.encode_target = ImageEncoder(3, widths[0], encoder_blocks)
        self.fuse = DeformableConv(widths[0], refine, widths[0])
        self.decode = Decoder(widths, blocks, 3)
        self.encode_fused = ImageEncoder(3, widths[0], encoder_blocks)
        self.modulate = DepthModulation(widths[0])
        self.decode_modulated = Decoder(widths[:1], blocks[:1], 3)

    def encode(self, views: NetworkInput) -> tuple[Float[Tensor, "b r c i j"], ...]:
        """Features of the references."""
        return (self.encode_reference.encode_each(pad_to_stride(views, self.stride).references - 0.5),)

    def stages(
        self, views: NetworkInput, encoded: tuple[Float[Tensor, "b r c i j"], ...] | None = None
    ) -> tuple[Float[Tensor, "b 3 h w"], Float[Tensor, "b 3 h w"]]:
        """H, the fused view, and E, H after depth modulation, at full resolution, from at most two references."""
        height, width = views.render.shape[-2:]
        references = (self.encode(views) if encoded is None else encoded)[0]
        views = pad_to_stride(views, self.stride)
        render = views.render
        target = self.encode_target(render - 0.5)
        fused = self.fuse(target, references.to(target.dtype), halved_visibility(views))
        fused_view = render + self.decode(fused).to(render.dtype)
        modulated = self.modulate(self.encode_fused(fused_view - 0.5), views.depth, views.depth_unit)
        enhanced = fused_view + self.decode_modulated(modulated).to(render.dtype)
        return fused_view[..., :height, :width], enhanced[..., :height, :width]
