"""Rotation of vectors between a Gaussian's axes and the world.

Axes: n Gaussians, s axes that a vector has (missing ones are 0).
"""

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.splat.oracle import rotations


def rotate_vectors(
    quaternions: Float[Tensor, "n 4"], vectors: Float[Tensor, "n s"], *, back: bool = False
) -> Float[Tensor, "n 3"]:
    """Rotate vectors from the Gaussians' axes to the world.

    Args:
        quaternions: (w, x, y, z), of any non-zero length.
        vectors: one vector per Gaussian.
        back: rotate from the world to the Gaussians' axes instead.
    """
    columns = rotations(quaternions).transpose(1, 2)
    if back:
        return (columns * vectors[:, None, :]).sum(2)
    return (columns[:, : vectors.shape[1]] * vectors[:, :, None]).sum(1)
