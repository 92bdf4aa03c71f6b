"""A backend's output on each Gaussian besides the image, and the passing of tensors to compiled kernels.

Axes: n Gaussians.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor


@dataclass
class ScreenStatistics:
    """Whether each Gaussian is seen and how strongly the image pulls it; what densification decides by.

    Handed to `render`, which fills the first member; its backward fills the other. Each render overwrites.

    Attributes:
        visible: whether any tile lists the Gaussian.
        gradient: length of the loss's gradient by the 2D mean in pixels (3DGS's criterion, there in half images).
    """

    visible: Bool[Tensor, " n"] | None = None
    gradient: Float[Tensor, " n"] | None = None


def numpy_view(tensor: Tensor) -> np.ndarray:
    """A contiguous NumPy view of a CPU tensor, copied only if it is not contiguous."""
    return tensor.detach().contiguous().numpy()
