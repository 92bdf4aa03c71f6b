"""New cameras between and around the training cameras, whose views are enhanced.

Axes: p new cameras.
"""

import dataclasses
from collections.abc import Sequence

import torch

from gaussian_enhancer.scene.camera_geometry import camera_distances
from gaussian_enhancer.scene.camera_path import PathSettings, capture_path
from gaussian_enhancer.types import Camera


def new_cameras(
    cameras: Sequence[Camera],
    count: int,
    max_displacement: int | float,
    *,
    round_index: int = 0,
    rounds: int = 1,
    seed: int = 0,
) -> tuple[Camera, ...]:
    """Cameras along a smooth path through the training cameras, each displaced at random.

    Displacement keeps the intrinsics and the viewing direction. Rounds use interleaved positions along the path, so no
    two rounds have the same positions.

    Args:
        cameras: training cameras, at least two; held-out cameras have no influence.
        count: number of new cameras.
        max_displacement: largest displacement from the path along each world axis, in mean distances from a training
            camera to its nearest neighbour.
        round_index: index of the round, from 0.
        rounds: number of rounds.
        seed: seed of the random numbers.
    """
    path_settings = PathSettings(frames=max(2, rounds * count), cameras=None)
    path = capture_path("interpolate", cameras, path_settings)[round_index::rounds][:count]
    spacing = float(camera_distances(cameras).fill_diagonal_(torch.inf).amin(1).mean())
    generator = torch.Generator().manual_seed((seed * 1_000_003 + round_index) % 2**63)
    offsets = max_displacement * spacing * (2 * torch.rand(len(path), 3, generator=generator) - 1)
    return tuple(_moved_camera(camera, offset) for camera, offset in zip(path, offsets, strict=True))


def _moved_camera(camera: Camera, offset: torch.Tensor) -> Camera:
    """Return the camera translated by an offset in world axes."""
    pose = camera.world_to_camera.clone()
    pose[:3, 3] -= camera.rotation @ offset.to(pose)
    return dataclasses.replace(camera, world_to_camera=pose)
