"""Rotation of vectors between a Gaussian's axes and the world.

Axes: n Gaussians, s axes that a vector has (missing ones are 0).
"""

import torch
from jaxtyping import Float
from torch import Tensor


def rotate_vectors(
    quaternions: Float[Tensor, "n 4"], vectors: Float[Tensor, "n s"], *, back: bool = False
) -> Float[Tensor, "n 3"]:
    """Rotate vectors from the Gaussians' axes to the world.

    Args:
        quaternions: (w, x, y, z), of any non-zero length.
        vectors: one vector per Gaussian.
        back: rotate from the world to the Gaussians' axes instead.
    """
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=1).unbind(1)
    columns = torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], 1),
            torch.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], 1),
            torch.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], 1),
        ],
        1,
    )
    if back:
        return (columns * vectors[:, None, :]).sum(2)
    return (columns[:, : vectors.shape[1]] * vectors[:, :, None]).sum(1)
