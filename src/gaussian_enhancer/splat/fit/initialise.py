"""Initial Gaussians: on given points, or at random points that the cameras see.

Axes: p points, n Gaussians, k spherical-harmonics coefficients, s scale axes.
"""

import math
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.scene import Points
from gaussian_enhancer.splat.fit.geometry import focus_distance, seen_from
from gaussian_enhancer.splat.oracle import SH_0
from gaussian_enhancer.types import Camera, Gaussians


def gaussians_from_points(
    points: Points,
    *,
    axes: int = 3,
    sh_degree: int = 1,
    opacity: float = 0.1,
    facing: Float[Tensor, "p 3"] | None = None,
) -> Gaussians:
    """One isotropic Gaussian per point; its standard deviation is the RMS distance to the three nearest points.

    Source: Kerbl et al., 3D Gaussian Splatting, SIGGRAPH 2023, section 5.1.

    Args:
        points: positions and colours.
        axes: number of scale axes, 3 for ellipsoids and 2 for disks.
        sh_degree: degree of the colour's spherical harmonics, 0 to 3; all but the constant start at zero.
        opacity: initial opacity, in (0, 1).
        facing: unit normal of the surface at each point, for the third axis (a disk's normal).

    Raises:
        InputError: there are no points, or they have values that are not finite.
    """
    count = len(points.positions)
    if count == 0:
        raise InputError("points to start from", "are none", "start with init=plane_sweep or init=random")
    if not (points.positions.isfinite().all() and points.colours.isfinite().all()):
        raise InputError("points to start from", "hold values that are not finite", "remove those points")
    scales = neighbour_distances(points.positions).clamp(min=1e-7).log()[:, None].repeat(1, axes)
    sh = torch.zeros(count, (sh_degree + 1) ** 2, 3)
    sh[:, 0] = (points.colours - 0.5) / SH_0
    quaternions = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1) if facing is None else _rotations_to(facing)
    logits = torch.full((count,), math.log(opacity / (1 - opacity)))
    return Gaussians(points.positions.clone(), scales, quaternions, logits, sh)


def random_points(cameras: Sequence[Camera], count: int, generator: torch.Generator) -> Points:
    """Random points that at least two cameras (or the only one) see, uniform over pixels and over inverse depth.

    Args:
        cameras: training cameras.
        count: number of points.
        generator: source of randomness.
    """
    distance = focus_distance(cameras)
    accepted: list[Tensor] = []
    rounds, accepted_count = 0, 0
    while accepted_count < count:
        points = torch.cat([_in_frustum(c, 1 + count // len(cameras), distance, generator) for c in cameras])
        visible_counts = torch.stack([seen_from(camera, points)[1] for camera in cameras]).sum(0)
        # Without overlap of the cameras the loop would never end: after eight rounds every point is accepted.
        accepted.append(points[visible_counts >= 2] if len(cameras) > 1 and rounds < 8 else points)
        rounds, accepted_count = rounds + 1, accepted_count + len(accepted[-1])
    positions = torch.cat(accepted)
    positions = positions[torch.randperm(len(positions), generator=generator)[:count]]
    return Points(positions, torch.rand(count, 3, generator=generator))


def neighbour_distances(positions: Float[Tensor, "p 3"]) -> Float[Tensor, " p"]:
    """Root mean square distance to the three nearest other points, by exact search.

    Args:
        positions: points in scene units; a single one has distance 1.
    """
    if len(positions) < 2:
        return torch.ones(len(positions))
    from gaussian_enhancer.splat.fit.neighbour_kernels import nearest_three

    values = positions.detach().cpu().double()
    axis = int(values.var(0).argmax())
    order = values[:, axis].argsort()
    squared = np.empty(len(values))
    nearest_three(np.ascontiguousarray(values[order].numpy()), axis, squared)
    result = torch.empty(len(values))
    result[order] = torch.from_numpy(squared).sqrt().float()
    return result


def _in_frustum(camera: Camera, count: int, distance: float, generator: torch.Generator) -> Tensor:
    """Random points in a camera's field of view at a third of to three times the focus distance."""
    pixels = torch.rand(count, 2, generator=generator) * torch.tensor([camera.width, camera.height])
    inverse_depths = (1 / 3 + torch.rand(count, 1, generator=generator) * (3 - 1 / 3)) / distance
    rays = torch.cat([pixels, torch.ones(count, 1)], 1) @ torch.linalg.inv(camera.K).T
    return (rays / inverse_depths - camera.world_to_camera[:3, 3]) @ camera.rotation


def _rotations_to(normals: Tensor) -> Tensor:
    """Quaternions of the smallest rotations that turn the z axis to the given unit directions."""
    w = 1 + normals[:, 2]
    quaternions = torch.stack([w, -normals[:, 1], normals[:, 0], torch.zeros_like(w)], 1)
    half_turn = torch.tensor([0.0, 1.0, 0.0, 0.0])
    quaternions = torch.where((w < 1e-6)[:, None], half_turn, quaternions)
    return quaternions / quaternions.norm(dim=1, keepdim=True)
