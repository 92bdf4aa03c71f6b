"""The null network.

Axes: b batch, h height, w width.
"""

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.network.network import Network
from gaussian_enhancer.types import NetworkInput


class Identity(Network):
    """Returns the render, the baseline of every gain. No parameters."""

    def __init__(self) -> None:
        super().__init__()
        self.describe({})

    def stages(self, views: NetworkInput) -> tuple[Float[Tensor, "b 3 h w"], ...]:
        """The render, as it is."""
        return (views.render,)
