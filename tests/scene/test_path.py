import dataclasses
import math

import pytest
import torch
from scipy.spatial.transform import Rotation

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.path import short_tour, smooth_path
from gaussian_enhancer.types import Camera, identity_camera
from support.projection import centres


def looking(centre: tuple[float, float, float], yaw: float = 0.0, focal: float = 50.0) -> Camera:
    camera = identity_camera(24, 32, focal, torch.float64)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = torch.from_numpy(Rotation.from_euler("y", -yaw).as_matrix())
    pose[:3, 3] = -pose[:3, :3] @ torch.tensor(centre, dtype=torch.float64)
    return dataclasses.replace(camera, world_to_camera=pose)


def circle(count: int, radius: float = 2.0) -> list[Camera]:
    angles = [0.25 * k for k in range(count)]
    return [looking((radius * math.cos(a), 0.0, radius * math.sin(a)), -a) for a in angles]


def test_path_passes_the_cameras():
    keys = circle(5)
    path = smooth_path(keys, 13)
    for key, found in zip(keys, path[::3], strict=True):
        torch.testing.assert_close(found.world_to_camera, key.world_to_camera, atol=1e-9, rtol=0)
        torch.testing.assert_close(found.K, key.K)
        assert (found.height, found.width) == (24, 32)


def test_path_stays_near_the_circle_that_its_cameras_stand_on():
    path = smooth_path(circle(6), 51)
    off = (centres(path).norm(dim=1) - 2).abs()
    assert off[10:41].max() < 5e-4
    assert off.max() < 0.01  # at the ends, where there is no further camera to go by; chords lie 0.016 inside


def test_straight_even_path_has_even_steps():
    keys = [looking((0.5 * k, -0.2 * k, 0.1 * k)) for k in range(4)]
    steps = centres(smooth_path(keys, 31)).diff(dim=0)
    torch.testing.assert_close(steps, steps[:1].expand_as(steps), atol=1e-9, rtol=0)


def test_rotation_is_smooth_and_proper():
    turns = torch.stack([camera.rotation for camera in smooth_path(circle(6), 51)])
    torch.testing.assert_close(turns @ turns.mT, torch.eye(3, dtype=torch.float64).expand_as(turns), atol=1e-9, rtol=0)
    relative = Rotation.from_matrix((turns[1:] @ turns[:-1].mT).numpy()).magnitude()
    assert relative.max() < 1.2 * relative.min()


def test_path_moves_with_the_world():
    generator = torch.Generator().manual_seed(0)
    keys = [looking(tuple(torch.rand(3, generator=generator).tolist()), 0.3 * k) for k in range(5)]
    motion = torch.eye(4, dtype=torch.float64)
    motion[:3, :3] = torch.from_numpy(Rotation.from_rotvec([0.3, -1.0, 0.4]).as_matrix())
    motion[:3, 3] = torch.tensor([3.0, 1.0, -2.0])
    other = [dataclasses.replace(key, world_to_camera=key.world_to_camera @ motion) for key in keys]
    for a, b in zip(smooth_path(keys, 17), smooth_path(other, 17), strict=True):
        torch.testing.assert_close(a.world_to_camera @ motion, b.world_to_camera, atol=1e-8, rtol=0)


def test_intrinsics_change_with_the_way():
    focals = [
        float(c.K[0, 0]) for c in smooth_path([looking((0, 0, 0), focal=40.0), looking((1, 0, 0), focal=60.0)], 5)
    ]
    assert focals == pytest.approx([40, 45, 50, 55, 60])


def test_two_cameras_at_one_place_are_passed():
    path = smooth_path([looking((0, 0, 0)), looking((0, 0, 0)), looking((1, 0, 0))], 9)
    assert bool(torch.isfinite(torch.stack([camera.world_to_camera for camera in path])).all())


def test_path_of_nothing_is_refused():
    with pytest.raises(InputError, match="at least 2"):
        smooth_path([looking((0, 0, 0))], 10)
    with pytest.raises(InputError, match="one size"):
        smooth_path([looking((0, 0, 0)), looking((1, 0, 0)).resized(12, 16)], 10)


def test_tour_keeps_a_video_and_untangles_a_heap():
    keys = circle(12)
    assert short_tour(keys) == tuple(range(12))
    heap = [5, 0, 9, 3, 11, 1, 7, 4, 10, 2, 8, 6]
    tour = [heap[i] for i in short_tour([keys[i] for i in heap])]
    assert tour in (list(range(12)), list(range(11, -1, -1)))


def test_even_speed_evens_out_what_unequal_gaps_make_uneven() -> None:
    keys = [looking((x, 0.0, 0.3 * x * x)) for x in (0.0, 0.2, 1.4, 1.5, 3.0)]
    even = centres(smooth_path(keys, 41, even_speed=True))
    steps = even.diff(dim=0).norm(dim=1)
    assert steps.max() < 1.01 * steps.min()
    plain = centres(smooth_path(keys, 41)).diff(dim=0).norm(dim=1)
    assert plain.max() > 1.5 * plain.min()
    torch.testing.assert_close(even[[0, -1]], centres([keys[0], keys[-1]]), atol=1e-9, rtol=0)


def test_tour_of_many_cameras_is_no_longer_than_any_reversal_would_make_it() -> None:
    generator = torch.Generator().manual_seed(1)
    keys = [looking((x, y, 0.0)) for x, y in torch.rand(40, 2, generator=generator).tolist()]
    at = centres([keys[i] for i in short_tour(keys)])

    def length(order: torch.Tensor) -> float:
        return float(order.diff(dim=0).norm(dim=1).sum())

    for i in range(40):
        for j in range(i + 1, 40):
            other = torch.cat([at[:i], at[i : j + 1].flip(0), at[j + 1 :]])
            assert length(other) >= length(at) - 1e-9
