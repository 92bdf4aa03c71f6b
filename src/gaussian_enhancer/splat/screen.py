"""What a backend tells of each Gaussian besides the picture, and how tensors reach compiled kernels.

Axes: n Gaussians.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor


@dataclass
class ScreenStatistics:
    """How large and how strongly pulled each Gaussian is on the image; what densification decides by.

    Handed to `render`, which fills the first two members; its backward fills the others. Each render overwrites.

    Attributes:
        radius: three standard deviations of the footprint's longer axis in pixels, 0 where not visible.
        visible: whether any tile lists the Gaussian.
        gradient: length of the loss's gradient by the 2D mean in pixels (3DGS's criterion, there in half images).
        absolute_gradient: the same with each pixel's share taken absolute before summing (AbsGS, Ye et al. 2024).
    """

    radius: Float[Tensor, " n"] | None = None
    visible: Bool[Tensor, " n"] | None = None
    gradient: Float[Tensor, " n"] | None = None
    absolute_gradient: Float[Tensor, " n"] | None = None


def array(tensor: Tensor) -> np.ndarray:
    """A contiguous NumPy view of a CPU tensor, copied only if it is not contiguous."""
    return tensor.detach().contiguous().numpy()
