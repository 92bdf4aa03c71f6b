"""Geometry of the cameras of a capture: distances, the point that they look at, and their upward direction.

Axes: c cameras.
"""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.types import Camera

COINCIDENT = 3e-7
"""Distance below which two cameras are at one place, in units of their largest coordinate: a few roundings of it."""


def camera_distances(cameras: Sequence[Camera]) -> Float[Tensor, "c c"]:
    """Distances between cameras (float64), in scene units; 0 between cameras at one place.

    They are sums of squared differences. The matrix product that `torch.cdist` uses from 26 cameras on is wrong by as
    much as cameras are apart where a capture is far from the origin, as in coordinates of a map.

    Args:
        cameras: cameras of a capture, at least one.
    """
    centres = torch.stack([camera.centre for camera in cameras]).cpu().double()
    distances = torch.cdist(centres, centres, compute_mode="donot_use_mm_for_euclid_dist")
    extent = centres.abs().amax(1)
    return torch.where(distances < COINCIDENT * torch.maximum(extent[:, None], extent), 0.0, distances)


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
