"""SIF, the paper's spatial information fusion network: render, references and depth to an enhanced view.

Axes: b batch, r references, c channels, h height, w width, i = h / 2, j = w / 2.
"""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.network.decode import Decoder
from gaussian_enhancer.network.deform import Unrefined
from gaussian_enhancer.network.depth_modulation import DepthModulated
from gaussian_enhancer.network.fuse import Trust
from gaussian_enhancer.network.network import CachesReferences
from gaussian_enhancer.network.output_head import Gated, Output
from gaussian_enhancer.network.pyramid import pad_to_stride
from gaussian_enhancer.network.stem import Choice, Gather
from gaussian_enhancer.types import NetworkInput


class SIF(CachesReferences):
    """Enhanced = compose(decode(gather(views))): one fusion at one scale.

    Residual and gates are zero at initialisation: the untrained network returns the render bit for bit. It is
    GaussianEnhancer's SIF with a decoder like NAFNet's, with trust in place of a convolution over a fixed pair of
    references, and with terms that pass the references' pixels to the output without encoding them (`compose`).

    Args:
        widths: channels at 1/2, 1/4, 1/8, ... of the resolution.
        blocks: number of residual blocks at each of these levels.
        encoder_blocks: number of residual blocks of the encoders.
        refine: learned alignment of the references' features.
        fusion: fusion of references with the target.
        modulation: modulation of the fused features by depth.
        output: output head.
        reference_renders: use the splat's renders of the references' views if they are known.
    """

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
        self.describe(locals())
        widths, blocks = [int(c) for c in widths], [int(n) for n in blocks]
        self.stride = 2 ** max(len(widths), 2)
        self.gather = Gather(widths[0], encoder_blocks, refine, fusion, modulation, reference_renders)
        self.decode = Decoder(widths, blocks, output.outputs)
        self.output = output

    def encode(self, views: NetworkInput) -> tuple[Float[Tensor, "b r c i j"], ...]:
        """Features of the references; `forward` can reuse them for other targets if references are not warped."""
        return (self.gather.encode(pad_to_stride(views, self.stride)),)

    def stages(
        self, views: NetworkInput, encoded: tuple[Float[Tensor, "b r c i j"], ...] | None = None
    ) -> tuple[Float[Tensor, "b 3 h w"], ...]:
        """The enhanced image, as the only scale. Any number of references is accepted, including none."""
        height, width = views.render.shape[-2:]
        views = pad_to_stride(views, self.stride)
        features, trust = self.gather(views, None if encoded is None else encoded[0])
        return (self.output(self.decode(features), views, trust)[..., :height, :width],)
