"""Statistics of each Gaussian from a render and its backward.

Axes: n Gaussians.
"""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor


@dataclass
class ScreenStatistics:
    """Visibility and screen gradient of each Gaussian, on which densification is based.

    An instance is passed to `render`. The forward sets ``visible``, the backward sets ``gradient``. The next render and
    its backward overwrite both.

    Attributes:
        visible: whether the Gaussian's footprint touches the image (on the CPU: whether any tile lists it).
        gradient: norm of the gradient of the loss with respect to the 2D mean in pixels. This is the criterion of 3DGS,
            which measures it in units of half the image instead.
    """

    visible: Bool[Tensor, " n"] | None = None
    gradient: Float[Tensor, " n"] | None = None
