"""Cameras between and around the training cameras, for views to be enhanced.

Axes: p new cameras.
"""

import dataclasses
from collections.abc import Sequence

import torch

from gaussian_enhancer.scene.camera_path import PathSettings, capture_path
from gaussian_enhancer.types import Camera


def new_cameras(
    cameras: Sequence[Camera], count: int, around: int | float, *, number: int = 0, rounds: int = 1, seed: int = 0
) -> tuple[Camera, ...]:
    """Cameras along a smooth way through the training cameras, each moved aside at random.

    They keep the lens and the direction of the way at their place. Rounds take turns along the way, so that none
    repeats another's places.

    Args:
        cameras: the training cameras, at least two; nothing else decides where the new ones are.
        count: how many.
        around: how far one leaves the way at most, in mean distances from one camera on the way to the next.
        number: of the round, from 0.
        rounds: of which it is one.
        seed: of the randomness.
    """
    every = PathSettings(frames=max(2, rounds * count), cameras=None)
    way = capture_path("interpolate", cameras, every)[number::rounds][:count]
    centres = torch.stack([camera.centre for camera in cameras])
    apart = torch.cdist(centres, centres)
    unit = float(apart.fill_diagonal_(torch.inf).amin(1).mean())
    generator = torch.Generator().manual_seed((seed * 1_000_003 + number) % 2**63)
    aside = around * unit * (2 * torch.rand(len(way), 3, generator=generator) - 1)
    return tuple(_moved_camera(camera, offset) for camera, offset in zip(way, aside, strict=True))


def _moved_camera(camera: Camera, offset: torch.Tensor) -> Camera:
    """The camera at another place, looking in the same direction."""
    pose = camera.world_to_camera.clone()
    pose[:3, 3] -= camera.rotation @ offset.to(pose)
    return dataclasses.replace(camera, world_to_camera=pose)
