"""The baseline without enhancement.

Axes: b batch, h height, w width.
"""

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.network.network import Network
from gaussian_enhancer.types import NetworkInput


class Identity(Network):
    """Returns the render, with which every gain is compared. It has no parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.describe({})

    def stages(self, views: NetworkInput) -> tuple[Float[Tensor, "b 3 h w"], ...]:
        """The render, unchanged."""
        return (views.render,)
