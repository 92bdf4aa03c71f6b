import dataclasses
import math

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.camera_path import PathSettings, capture_path, common_lens, refuse_outside, resize_to_even
from gaussian_enhancer.types import Camera, identity_camera
from support.projection import centres, project

TARGET = torch.tensor([0.5, 0.25, 3.0])


def looking_at(eye: tuple[float, float, float], target: torch.Tensor, focal: float = 50.0) -> Camera:
    """A camera that looks at a point; y of the world points down, as in COLMAP."""
    forward = torch.nn.functional.normalize(target - torch.tensor(eye), dim=0)
    right = torch.nn.functional.normalize(torch.linalg.cross(torch.tensor([0.0, 1.0, 0.0]), forward), dim=0)
    pose = torch.eye(4)
    pose[:3, :3] = torch.stack([right, torch.linalg.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ torch.tensor(eye)
    return dataclasses.replace(identity_camera(24, 32, focal), world_to_camera=pose)


def ring(count: int, radius: float = 2.0, height: float = 1.0, around: float = 2 * math.pi) -> list[Camera]:
    x, y, z = TARGET.tolist()
    angles = [around * k / count for k in range(count)]
    return [looking_at((x + radius * math.cos(a), y - height, z + radius * math.sin(a)), TARGET) for a in angles]


def grid() -> list[Camera]:
    """A forward-facing capture: parallel cameras on a plane."""
    cameras = []
    for x in (-0.4, 0.0, 0.4):
        for y in (-0.2, 0.0, 0.2):
            camera = identity_camera(24, 32, 50.0)
            pose = torch.eye(4)
            pose[:3, 3] = -torch.tensor([x, y, 0.0])
            cameras.append(dataclasses.replace(camera, world_to_camera=pose))
    return cameras


def assert_rigid(path) -> None:
    for camera in path:
        torch.testing.assert_close(camera.rotation @ camera.rotation.T, torch.eye(3), atol=1e-5, rtol=0)
        assert float(torch.linalg.det(camera.rotation)) == pytest.approx(1, abs=1e-5)


def test_an_orbit_of_a_ring_is_the_ring_and_looks_at_its_middle():
    path = capture_path("orbit", ring(9), PathSettings(frames=40))
    away = centres(path) - TARGET
    torch.testing.assert_close(away[:, 1], torch.full((40,), -1.0), atol=1e-4, rtol=0)
    torch.testing.assert_close(away[:, [0, 2]].norm(dim=1), torch.full((40,), 2.0), atol=1e-4, rtol=0)
    for camera in path:
        torch.testing.assert_close(project(camera, TARGET), torch.tensor([16.0, 12.0]), atol=1e-2, rtol=0)
        assert camera.rotation[1, 1] > 0.8  # y of camera and world both point down
    assert_rigid(path)
    steps = centres([*path, path[0]]).diff(dim=0).norm(dim=1)
    torch.testing.assert_close(steps, steps[:1].expand_as(steps), atol=1e-4, rtol=0)


def test_radius_and_turns_of_an_orbit():
    path = capture_path("orbit", ring(9), PathSettings(frames=40, radius=0.5, turns=0.25))
    away = centres(path) - TARGET
    torch.testing.assert_close(away.norm(dim=1), torch.full((40,), 0.5 * 5**0.5), atol=1e-4, rtol=0)
    cosine = (away[0, [0, 2]] @ away[-1, [0, 2]]) / away[0, [0, 2]].norm() ** 2
    assert float(cosine) == pytest.approx(math.cos(math.pi / 2 * 39 / 40), abs=1e-3)


def test_an_interpolated_path_begins_and_ends_at_cameras_and_keeps_its_speed():
    keys = ring(12, around=5.0)
    path = capture_path("interpolate", keys, PathSettings(frames=50, cameras=None))
    torch.testing.assert_close(centres(path)[[0, -1]], centres([keys[0], keys[-1]]), atol=1e-4, rtol=0)
    steps = centres(path).diff(dim=0).norm(dim=1)
    assert steps.max() < 1.1 * steps.min()
    assert_rigid(path)


def test_fewer_cameras_make_a_smoother_path():
    generator = torch.Generator().manual_seed(0)
    shaken = []
    for key in ring(24, around=5.0):
        pose = key.world_to_camera.clone()
        pose[:3, 3] += 0.05 * torch.randn(3, generator=generator)
        shaken.append(dataclasses.replace(key, world_to_camera=pose))

    def bend(count: int | None) -> float:
        path = capture_path("interpolate", shaken, PathSettings(frames=200, cameras=count))
        return float(centres(path).diff(n=2, dim=0).norm(dim=1).mean())

    assert bend(6) < 0.5 * bend(None)


def test_a_spiral_stays_within_the_spread_and_looks_ahead():
    path = capture_path("spiral", grid(), PathSettings(frames=60))
    assert centres(path)[:, 0].abs().max() <= 0.4 + 1e-5
    assert centres(path)[:, 1].abs().max() <= 0.2 + 1e-5
    assert centres(path)[:, 0].min() < -0.35
    assert min(float(camera.forward[2]) for camera in path) > 0.9
    assert_rigid(path)
    closing = (path[0].centre - path[-1].centre).norm()
    assert closing < 2 * (path[1].centre - path[0].centre).norm()


def test_paths_that_a_capture_does_not_allow_are_refused_with_another():
    with pytest.raises(InputError, match="optical axes do not meet; use path=interpolate"):
        capture_path("orbit", grid(), PathSettings())
    with pytest.raises(InputError, match="look all around; use path=orbit"):
        capture_path("spiral", ring(8), PathSettings())
    for shape in ("interpolate", "orbit", "spiral"):
        with pytest.raises(InputError, match="which has 1; give a capture of more photos"):
            capture_path(shape, ring(1), PathSettings())
    with pytest.raises(InputError, match="at the same place"):
        capture_path("spiral", [grid()[0]] * 3, PathSettings())


@pytest.mark.parametrize("wrong", [{"frames": 1}, {"cameras": 1}, {"turns": 0}, {"radius": -1.0}])
def test_numbers_out_of_range_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        PathSettings(**wrong)


def test_one_lens_serves_a_capture_of_several():
    keys = ring(5)
    odd = dataclasses.replace(keys[1], K=keys[1].K * torch.tensor([[1.2], [1.2], [1.0]]))
    other = looking_at((0.0, 0.0, 0.0), TARGET).resized(48, 64)
    lens = common_lens([other, keys[0], odd, keys[2], keys[3]])
    assert (lens.height, lens.width) == (24, 32)
    torch.testing.assert_close(lens.K, keys[0].K)
    path = capture_path("interpolate", [other, *keys], PathSettings(frames=5))
    assert {(camera.height, camera.width, float(camera.K[0, 0])) for camera in path} == {(24, 32, 50.0)}


def test_frames_have_even_sides():
    (camera,) = resize_to_even([identity_camera(25, 33, 50.0)])
    assert (camera.height, camera.width) == (24, 32)
    torch.testing.assert_close(camera.K, identity_camera(25, 33, 50.0).K)
    (camera,) = resize_to_even([identity_camera(24, 32, 50.0)], height=12)
    assert (camera.height, camera.width, float(camera.K[0, 0])) == (12, 16, 25.0)
    with pytest.raises(InputError, match="32x24 and 16x12"):
        resize_to_even([identity_camera(24, 32, 50.0), identity_camera(12, 16, 50.0)])
    with pytest.raises(InputError, match="at least 2x2"):
        resize_to_even([identity_camera(24, 32, 50.0)], height=1)


def test_a_path_outside_the_capture_is_refused():
    keys = ring(8)
    refuse_outside(capture_path("orbit", keys, PathSettings(frames=20)), keys, "path=orbit")
    far = [*keys[:3], looking_at((40.0, 0.0, 0.0), TARGET)]
    with pytest.raises(InputError, match=r"path\.json: leaves the capture: camera 4 of 4 is 9\.\d times"):
        refuse_outside(far, keys, "path.json")
