"""Geometry that the cameras of a capture have in common: the point that they look at, and their upward direction.

Axes: c cameras.
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.types import Camera


def focus_point(
    cameras: Sequence[Camera], min_eigenvalue: float
) -> tuple[Float[Tensor, " 3"], Float[Tensor, " c"]] | None:
    """Point of the least squared distance from all viewing axes, and its distance along each axis, in scene units.

    Args:
        cameras: cameras of a capture, at least one.
        min_eigenvalue: axes of directions d count as parallel if the smallest eigenvalue of the mean of I - d d^T is
            below this.

    Returns:
        Point and distances (float64, negative behind a camera), or None if the axes are parallel.
    """
    centres = torch.stack([camera.centre for camera in cameras]).cpu().double()
    axes = torch.stack([camera.forward for camera in cameras]).cpu().double()
    projectors = torch.eye(3, dtype=torch.float64) - axes[:, :, None] * axes[:, None, :]
    system = projectors.mean(0)
    if torch.linalg.eigvalsh(system)[0] < min_eigenvalue:
        return None
    point = torch.linalg.solve(system, (projectors @ centres[:, :, None]).mean(0))[:, 0]
    return point, ((point - centres) * axes).sum(1)


def mean_up(cameras: Sequence[Camera]) -> Float[np.ndarray, " 3"]:
    """Mean of the cameras' upward directions in float64; it is near 0 where they cancel."""
    return -np.stack([camera.rotation[1].double().cpu().numpy() for camera in cameras]).mean(0)
