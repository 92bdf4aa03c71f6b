"""A textured plane as cameras see it exactly: colours and depth in double precision."""

import dataclasses
import math

import torch

from gaussian_enhancer.types import Camera, identity_camera


def texture(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    return torch.stack(
        [0.5 + 0.4 * torch.sin(3 * x + 1), 0.5 + 0.4 * torch.cos(4 * y), 0.5 + 0.3 * torch.sin(2 * x * y)]
    )


def plane(camera: Camera, distance: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Colour and depth of the textured plane z = distance, seen exactly."""
    y, x = torch.meshgrid(
        torch.arange(camera.height, dtype=torch.float64) + 0.5,
        torch.arange(camera.width, dtype=torch.float64) + 0.5,
        indexing="ij",
    )
    rays = torch.linalg.inv(camera.K) @ torch.stack([x, y, torch.ones_like(x)]).flatten(1)
    world = camera.rotation.T @ rays
    reach = (distance - camera.centre[2]) / world[2]
    points = camera.centre[:, None] + reach * world
    shape = (camera.height, camera.width)
    return texture(points[0], points[1]).view(3, *shape), reach.view(1, *shape)


def turned(camera: Camera, angle: float, shift: tuple[float, float, float]) -> Camera:
    pose = torch.eye(4, dtype=torch.float64)
    c, s = math.cos(angle), math.sin(angle)
    pose[:3, :3] = torch.tensor([[c, 0, -s], [0, 1, 0], [s, 0, c]], dtype=torch.float64)
    pose[:3, 3] = -pose[:3, :3] @ torch.tensor(shift, dtype=torch.float64)
    return dataclasses.replace(camera, world_to_camera=pose)


TARGET = identity_camera(48, 64, 60.0, torch.float64)
REFERENCE = turned(identity_camera(480, 640, 600.0, torch.float64), 0.1, (0.3, 0.05, -0.1))
