"""Where Gaussians start: exact neighbour distances, frusta, orientation, refusal."""

import dataclasses

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.scene import Points
from gaussian_enhancer.splat.fit.geometry import focus_distance
from gaussian_enhancer.splat.fit.initialise import gaussians_from_points, neighbour_distances, random_points
from gaussian_enhancer.splat.oracle import SH_0
from gaussian_enhancer.types import identity_camera


def ring_of_cameras(radius: float, count: int = 6):
    """Cameras on an arc about the origin, all looking at it."""
    cameras = []
    for angle in torch.linspace(0, 1.5, count).tolist():
        c, s = torch.cos(torch.tensor(angle)), torch.sin(torch.tensor(angle))
        pose = torch.eye(4)
        pose[:3, :3] = torch.stack(
            [torch.stack([c, c * 0, -s]), torch.tensor([0.0, 1.0, 0.0]), torch.stack([s, c * 0, c])]
        )
        pose[2, 3] = radius
        cameras.append(dataclasses.replace(identity_camera(48, 64, 60.0), world_to_camera=pose))
    return cameras


@pytest.mark.parametrize("count", [2, 3, 4, 500])
def test_neighbour_distances_are_exact(count):
    positions = torch.randn(count, 3, generator=torch.Generator().manual_seed(count))
    distances = torch.cdist(positions.double(), positions.double())
    distances.fill_diagonal_(torch.inf)
    found = min(3, count - 1)
    expected = (distances.topk(found, largest=False).values ** 2).mean(1).sqrt().float()
    torch.testing.assert_close(neighbour_distances(positions), expected)


def test_coinciding_points_have_finite_scales():
    points = Points(torch.zeros(5, 3), torch.full((5, 3), 0.5))
    assert gaussians_from_points(points).log_scales.isfinite().all()


def test_colours_survive_the_spherical_harmonics():
    colours = torch.rand(7, 3, generator=torch.Generator().manual_seed(0))
    gaussians = gaussians_from_points(Points(torch.randn(7, 3), colours), sh_degree=2, opacity=0.2)
    torch.testing.assert_close(gaussians.sh[:, 0] * SH_0 + 0.5, colours)
    assert gaussians.sh.shape == (7, 9, 3)
    torch.testing.assert_close(gaussians.opacity_logits.sigmoid(), torch.full((7,), 0.2))


def test_disks_face_where_they_are_told():
    facing = torch.nn.functional.normalize(torch.randn(20, 3, generator=torch.Generator().manual_seed(1)), dim=1)
    facing[0] = torch.tensor([0.0, 0.0, -1.0])
    points = Points(torch.randn(20, 3), torch.rand(20, 3))
    q = gaussians_from_points(points, axes=2, facing=facing).quaternions
    w, x, y, z = q.T
    normal = torch.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], 1)
    torch.testing.assert_close(normal, facing, atol=1e-5, rtol=0)


def test_focus_is_where_the_axes_meet():
    assert focus_distance(ring_of_cameras(3.0)) == pytest.approx(3.0, rel=1e-4)


def test_random_points_lie_where_two_cameras_look_and_repeat_with_the_seed():
    cameras = ring_of_cameras(3.0)
    first = random_points(cameras, 300, torch.Generator().manual_seed(5))
    again = random_points(cameras, 300, torch.Generator().manual_seed(5))
    assert torch.equal(first.positions, again.positions)
    seen = torch.zeros(300)
    for camera in cameras:
        local = first.positions @ camera.rotation.T + camera.world_to_camera[:3, 3]
        pixels = (local @ camera.K.T)[:, :2] / local[:, 2:]
        inside = (pixels >= 0).all(1) & (pixels < torch.tensor([64, 48])).all(1)
        seen += inside & (local[:, 2] > 0)
    assert (seen >= 2).all()


def test_nothing_to_start_from_is_refused():
    with pytest.raises(InputError, match="are none"):
        gaussians_from_points(Points(torch.zeros(0, 3), torch.zeros(0, 3)))
    with pytest.raises(InputError, match="not finite"):
        gaussians_from_points(Points(torch.full((1, 3), torch.nan), torch.zeros(1, 3)))
