"""Plane sweep: the depth of a textured plane that cameras see from several places."""

import dataclasses
import math
import os
import subprocess
import sys
import weakref

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.fit.plane_sweep import SweepSettings, sweep_points
from gaussian_enhancer.types import Camera, identity_camera

HEIGHT, WIDTH, FOCAL = 48, 64, 60.0


def view_of_plane(x: float, turn: float, slope: float, depth: float) -> tuple[torch.Tensor, Camera]:
    """A camera at (x, 0, 0) turned about y, and its photo of the plane z = depth + slope * x."""
    c, s = math.cos(turn), math.sin(turn)
    rotation = torch.tensor([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    pose = torch.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ torch.tensor([x, 0.0, 0.0])
    K = identity_camera(HEIGHT, WIDTH, FOCAL).K
    v, u = torch.meshgrid(torch.arange(HEIGHT) + 0.5, torch.arange(WIDTH) + 0.5, indexing="ij")
    rays = torch.stack([u, v, torch.ones_like(u)], -1) @ torch.linalg.inv(K).T @ rotation
    along = (depth + slope * x) / (rays[..., 2] - slope * rays[..., 0])
    hit_x, hit_y = x + along * rays[..., 0], along * rays[..., 1]
    waves = [(5.0, 1.3, 0.2), (-2.1, 6.3, 1.0), (9.1, 4.7, 2.0)]
    photo = torch.stack([0.5 + 0.4 * torch.sin(a * hit_x + b * hit_y + p) for a, b, p in waves])
    return photo, Camera(K, pose, HEIGHT, WIDTH)


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_plane_is_recovered(slope):
    views = [view_of_plane(x, -x / 4, slope, 4.0) for x in (-0.6, -0.2, 0.2, 0.6)]
    swept = sweep_points(lambda i: views[i][0], [c for _, c in views], SweepSettings(reduction=1))
    positions = swept.points.positions
    error = (positions[:, 2] - 4.0 - slope * positions[:, 0]).abs() / 4.0
    assert len(positions) > HEIGHT * WIDTH / 2
    assert error.median() < 0.01
    assert error.quantile(0.95) < 0.05


def test_points_carry_the_photo_colours():
    views = [view_of_plane(x, 0.0, 0.0, 4.0) for x in (0.0, 0.5)]
    points = sweep_points(lambda i: views[i][0], [c for _, c in views], SweepSettings(reduction=1)).points
    expected = 0.5 + 0.4 * torch.sin(5.0 * points.positions[:, 0] + 1.3 * points.positions[:, 1] + 0.2)
    assert (points.colours[:, 0] - expected).abs().median() < 0.05


def test_photos_are_read_one_by_one_and_only_those_that_are_swept():
    views, read, alive = [view_of_plane(x / 10, 0.0, 0.0, 4.0) for x in range(11)], [], []

    def reader(number: int) -> torch.Tensor:
        photo = views[number][0].clone()
        read.append(number)
        alive.append(weakref.ref(photo))
        assert sum(one() is not None for one in alive) <= 3  # loops hold on to a photo or two
        return photo

    swept = sweep_points(reader, [c for _, c in views], SweepSettings(reduction=1, views=6))
    assert read == [0, 2, 4, 6, 8, 10]
    chosen = views[::2]
    expected = sweep_points(lambda i: chosen[i][0], [c for _, c in chosen], SweepSettings(reduction=1))
    assert torch.equal(swept.points.positions, expected.points.positions)


def test_one_photo_is_refused():
    photo, camera = view_of_plane(0.0, 0.0, 0.0, 4.0)
    with pytest.raises(InputError, match="at least two"):
        sweep_points(lambda i: photo, [camera])


def test_cameras_at_one_place_are_refused():
    photo, camera = view_of_plane(0.0, 0.0, 0.0, 4.0)
    with pytest.raises(InputError, match="one place"):
        sweep_points(lambda i: photo, [camera, camera])


def test_many_cameras_at_one_place_far_from_the_origin_are_refused():
    """Turned cameras, whose places differ by the rounding of their poses."""
    cameras = []
    for turn in torch.linspace(0.0, 0.3, 30).tolist():
        photo, camera = view_of_plane(0.0, turn, 0.0, 4.0)
        pose = camera.world_to_camera.clone()
        pose[:3, 3] = -pose[:3, :3] @ torch.tensor([5000.0, 3000.0, 100.0])
        cameras.append(dataclasses.replace(camera, world_to_camera=pose))
    with pytest.raises(InputError, match="one place"):
        sweep_points(lambda i: photo, cameras)


OUT_OF_RANGE = {
    "views": (1, -1),
    "planes": (1, 0),
    "neighbours": (0,),
    "reduction": (-2,),
    "radius": (-1,),
    "smoothness": (-0.5,),
    "agreement": (-0.5,),
    "confirmations": (-1,),
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name in OUT_OF_RANGE for value in OUT_OF_RANGE[name]])
def test_settings_out_of_range_are_refused(name, value):
    with pytest.raises(InputError, match=rf"sweep\.{name}: is {value}; give a number of at least"):
        SweepSettings(**{name: value})


def test_the_smallest_settings_are_swept():
    views = [view_of_plane(x, -x / 4, 0.0, 4.0) for x in (-0.6, -0.2, 0.2, 0.6)]
    smallest = SweepSettings(
        planes=2, neighbours=1, reduction=1, radius=0, smoothness=0.0, agreement=0.0, confirmations=0, views=2
    )
    positions = sweep_points(lambda i: views[i][0], [c for _, c in views], smallest).points.positions
    assert positions.isfinite().all()


SMOOTHED = """
import hashlib
import numpy as np
from gaussian_enhancer.splat.fit.plane_sweep_kernels import aggregate_costs, best_plane
generator = np.random.default_rng(0)
volume, image = generator.random((24, 32, 16), np.float32), generator.random((24, 32, 3), np.float32)
total, index = np.zeros_like(volume), np.empty((24, 32), np.float32)
aggregate_costs(volume, image, np.float32(0.05), np.float32(0.4), total)
best_plane(total, index)
print(hashlib.sha256(total.tobytes() + index.tobytes()).hexdigest(), sum(aggregate_costs.stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_compiled_and_cached_kernels_give_the_same_planes(tmp_path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_NUM_THREADS": "1"}
    command = [sys.executable, "-c", SMOOTHED]
    said = [subprocess.run(command, env=environment, capture_output=True, text=True, check=True) for _ in range(2)]
    (first, compiled), (second, cached) = (one.stdout.split() for one in said)
    assert (compiled, cached) == ("0", "1")
    assert first == second
