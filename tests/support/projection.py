"""Where cameras are, and where they see points."""

from collections.abc import Iterable

import torch

from gaussian_enhancer.types import Camera


def project(camera: Camera, point: torch.Tensor) -> torch.Tensor:
    """The pixel (x, y) at which a camera sees a point of the world."""
    local = camera.K @ (camera.rotation @ point + camera.world_to_camera[:3, 3])
    return local[:2] / local[2]


def centres(cameras: Iterable[Camera]) -> torch.Tensor:
    return torch.stack([camera.centre for camera in cameras])
