"""Geometry of a scene from its cameras: which views match well."""

import dataclasses

import pytest
import torch

from gaussian_enhancer.splat.fit.geometry import focus_distance, matching_cost
from gaussian_enhancer.types import Camera, identity_camera


def row_of_cameras(count: int, offset: tuple[float, float, float]) -> list[Camera]:
    """Parallel cameras, one unit apart."""
    cameras = []
    for i in range(count):
        pose = torch.eye(4)
        pose[:3, 3] = -torch.tensor(offset) - torch.tensor([float(i), 0.0, 0.0])
        cameras.append(dataclasses.replace(identity_camera(48, 64, 50.0), world_to_camera=pose))
    return cameras


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (5000.0, 3000.0, 100.0)])
def test_views_at_the_ideal_angle_match_best(offset) -> None:
    """Two units at a distance of 13 are the ideal angle."""
    cost = matching_cost(row_of_cameras(30, offset), 2.0 / 0.15)
    for i in range(2, 28):
        assert set(cost[i].argsort()[:2].tolist()) == {i - 2, i + 2}
        assert cost[i, i + 2] == pytest.approx(0.0, abs=1e-5)


def test_views_from_one_place_do_not_match() -> None:
    cameras = row_of_cameras(30, (5000.0, 3000.0, 100.0))
    cameras[7] = cameras[6]
    cost = matching_cost(cameras, 10.0)
    assert cost[6, 7] == cost[7, 6] == torch.inf
    assert cost.isinf().sum() == len(cameras) + 2


def test_the_distance_of_parallel_cameras_does_not_depend_on_the_origin() -> None:
    assert focus_distance(row_of_cameras(30, (5000.0, 3000.0, 100.0))) == pytest.approx(5.0, rel=1e-3)
