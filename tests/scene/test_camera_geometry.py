"""Distances between the cameras of a capture."""

import dataclasses

import pytest
import torch

from gaussian_enhancer.scene.camera_geometry import camera_distances
from gaussian_enhancer.scene.neighbours import camera_spacing
from gaussian_enhancer.types import Camera, identity_camera


def camera_at(x: float, y: float, z: float, turn: float = 0.0) -> Camera:
    c, s = torch.tensor(turn).cos(), torch.tensor(turn).sin()
    pose = torch.eye(4)
    pose[:3, :3] = torch.tensor([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    pose[:3, 3] = -pose[:3, :3] @ torch.tensor([x, y, z])
    return dataclasses.replace(identity_camera(24, 32, 40.0), world_to_camera=pose)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (5000.0, 3000.0, 100.0)])
@pytest.mark.parametrize("count", [2, 25, 26, 60])
def test_distances_do_not_depend_on_the_number_of_cameras_and_the_origin(count, offset) -> None:
    x, y, z = offset
    cameras = [camera_at(x + i, y, z, turn=0.01 * i) for i in range(count)]
    positions = torch.arange(count, dtype=torch.float64)
    torch.testing.assert_close(camera_distances(cameras), (positions - positions[:, None]).abs(), atol=5e-3, rtol=0)


def test_cameras_in_coordinates_of_a_map_are_apart() -> None:
    cameras = [camera_at(500_000.0 + 2 * i, 4_500_000.0, 100.0) for i in range(6)]
    assert camera_spacing(cameras) == 2.0


def test_a_stray_camera_far_away_does_not_merge_the_others() -> None:
    cameras = [camera_at(0.05 * i, 0.0, 0.0) for i in range(10)]
    assert camera_spacing([*cameras, camera_at(1e5, 0.0, 0.0)]) == pytest.approx(0.05)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (1.0, 2.0, 3.0), (5000.0, 3000.0, 100.0)])
def test_cameras_at_one_place_have_no_distance(offset) -> None:
    cameras = [camera_at(*offset, turn=0.05 * i) for i in range(30)]
    assert camera_distances(cameras).eq(0).all()
    assert camera_spacing(cameras) == 1.0
