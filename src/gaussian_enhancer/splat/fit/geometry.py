"""Geometry of a scene from its cameras alone: extent, distance, and which views match well.

Axes: p positions, v views. Distances are in scene units.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gaussian_enhancer.scene.camera_geometry import camera_distances, focus_point
from gaussian_enhancer.types import Camera

TRIANGULATION = 0.15
"""Baseline over distance (radians) at which two views match well: enough parallax, little change of appearance."""


def camera_extent(cameras: Sequence[Camera]) -> float:
    """Largest distance of a camera from the cameras' mean, times 1.1: the unit of 3DGS's learning rates.

    Args:
        cameras: training cameras; if all are at one place, the extent is 1.
    """
    centres = torch.stack([camera.centre for camera in cameras])
    radius = (centres - centres.mean(0)).norm(dim=1).max().item()
    return 1.1 * radius if radius > 0 else 1.0


def focus_distance(cameras: Sequence[Camera]) -> float:
    """Median distance along the viewing axes to the point that is nearest to all of them.

    If the axes are parallel or diverge, no such point exists. The result is then five times the median distance
    between neighbouring cameras, which corresponds to an overlap of about three quarters at common fields of view.

    Args:
        cameras: training cameras; if all are at one place, the result may be 1.
    """
    focus = focus_point(cameras, min_eigenvalue=1e-2)
    if focus is not None:
        _, depths = focus
        if (depths > 0).double().mean() > 0.8:
            return float(depths[depths > 0].median())
    nearest = camera_distances(cameras).fill_diagonal_(torch.inf).min(1).values
    nearest = nearest[nearest.isfinite() & (nearest > 0)]
    return 5.0 * float(nearest.median()) if len(nearest) else 1.0


def seen_from(camera: Camera, positions: Float[Tensor, "p 3"]) -> tuple[Float[Tensor, " p"], Bool[Tensor, " p"]]:
    """Depth of each position, and whether it projects into the camera's image."""
    points = positions @ camera.rotation.T + camera.world_to_camera[:3, 3]
    pixels = points @ camera.K.T
    x, y = pixels[:, 0] / pixels[:, 2], pixels[:, 1] / pixels[:, 2]
    return points[:, 2], (pixels[:, 2] > 0) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)


def matching_cost(cameras: Sequence[Camera], distance: float) -> Float[Tensor, "v v"]:
    """Cost of matching two views: large far from the ideal triangulation angle, or if their axes differ much.

    A view from the same place gives no information about depth: its cost is infinite.

    Args:
        cameras: cameras of the views.
        distance: typical distance to the scene.
    """
    axes = torch.stack([camera.forward for camera in cameras])
    triangulation_angle = camera_distances(cameras).to(axes) / distance
    axis_angle = torch.arccos((axes @ axes.T).clamp(-1, 1))
    cost = (triangulation_angle / TRIANGULATION).log().abs() + 3.0 * (axis_angle - 0.5).clamp(min=0)
    return cost.fill_diagonal_(torch.inf)
