"""The baseline of super-resolution without a network.

Axes: b batch, h height, w width, H = 4 h, W = 4 w.
"""

from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.network.network import Network
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.types import NetworkInput


class Bicubic(Network):
    """Upsamples the render by 4 with bicubic interpolation, not clamped. It has no parameters."""

    scale: ClassVar[int] = 4

    def __init__(self) -> None:
        super().__init__()
        self.describe({})

    def stages(self, views: NetworkInput) -> tuple[Float[Tensor, "b 3 H W"], ...]:
        """The upsampled render."""
        return (upsample_bicubic(views.render, self.scale),)
