"""Disk projection: the reformulated intersection is Huang et al.'s, and the footprints leave no pixel out."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from gaussian_enhancer.splat.disks import Disks, project_disks, project_disks_backward
from gaussian_enhancer.splat.ewa import Shape, view_of
from gaussian_enhancer.splat.methods import TwoDGS
from gaussian_enhancer.splat.oracle import ALPHA_MIN, project, rotations
from gaussian_enhancer.splat.tiles import TILE, bin_tiles
from gaussian_enhancer.types import Camera, Gaussians, identity_camera


def scene(count: int, size: float, stretch: float = 0.5, seed: int = 0) -> Gaussians:
    draw = torch.Generator().manual_seed(seed)
    return Gaussians(
        means=torch.randn(count, 3, generator=draw) + torch.tensor([0.0, 0.0, 2.5]),
        log_scales=torch.randn(count, 2, generator=draw) * stretch + size,
        quaternions=torch.randn(count, 4, generator=draw),
        opacity_logits=torch.randn(count, generator=draw) * 3,
        sh=torch.zeros(count, 1, 3),
    )


def shape_of(splat: Gaussians) -> Shape:
    tensors = (splat.means, splat.log_scales, splat.quaternions, splat.opacity_logits, torch.zeros(len(splat)))
    return Shape(*(tensor.numpy() for tensor in tensors))


def camera() -> Camera:
    plain = identity_camera(61, 83, 50.0)
    turn = torch.eye(4)
    turn[:3, :3] = rotations(torch.tensor([[1.0, 0.05, -0.1, 0.2]]))[0]
    return Camera(plain.K, turn, plain.height, plain.width)


def hits(disks: Disks, g: int, x: float, y: float) -> tuple[float, float, float]:
    """Object coordinates and z of the intersection, from the linear form."""
    row = disks.geometry[g]
    dx, dy = x - row[0], y - row[1]
    D = row[6] + row[7] * dx + row[8] * dy
    return (row[2] * dx + row[3] * dy) / D, (row[4] * dx + row[5] * dy) / D, disks.depths[g] * row[6] / D


def test_linear_form_meets_the_plane_where_the_ray_does() -> None:
    splat, eye = scene(30, -1.5), camera()
    disks = project_disks(shape_of(splat), view_of(eye, 0.01))
    R = rotations(splat.quaternions.double())
    for g in np.flatnonzero(disks.footprints[:, 2] > 0):
        u, v, z = hits(disks, g, 40.5, 21.5)
        local = torch.tensor([u, v], dtype=torch.float64) * splat.log_scales[g].double().exp()
        point = splat.means[g].double() + R[g][:, :2] @ local
        seen = eye.rotation.double() @ point + eye.world_to_camera[:3, 3].double()
        pixel = eye.K.double() @ seen / seen[2]
        assert pixel[:2].tolist() == pytest.approx([40.5, 21.5], abs=1e-3)
        assert z == pytest.approx(seen[2].item(), rel=1e-4)


@pytest.mark.parametrize(
    "splat",
    [scene(150, -2.5), scene(150, -5.0), scene(60, -0.5), scene(150, -2.5, 3.0), scene(60, 1.0, 2.0)],
    ids=["usual", "subpixel", "large", "needles", "around the camera"],
)
def test_no_pixel_above_the_threshold_is_left_out_and_few_are_in_vain(splat: Gaussians) -> None:
    eye = camera()
    view = view_of(eye, 0.01)
    disks = project_disks(shape_of(splat), view)
    lists = bin_tiles(disks.footprints, disks.depths, eye.height, eye.width)
    listed = np.zeros((len(splat), eye.height, eye.width), bool)
    across = -(-eye.width // TILE)
    for tile in range(len(lists.tile_starts) - 1):
        top, left = tile // across * TILE, tile % across * TILE
        for e in range(lists.tile_starts[tile], lists.tile_starts[tile + 1]):
            first, end = lists.rows[e]
            listed[lists.gaussians[e], top + first : top + end, left : left + TILE] = True
    z = (splat.means @ eye.rotation.T)[:, 2]
    order = torch.argsort(z, stable=True)
    order = order[z[order] > 0.01]
    layers = project(splat.to(torch.float64), eye.to(torch.float64), TwoDGS(), 0.01)
    y, x = torch.meshgrid(torch.arange(eye.height) + 0.5, torch.arange(eye.width) + 0.5, indexing="ij")
    power, _ = layers.falloff(torch.stack([x, y], -1).reshape(-1, 2).double())
    seen = np.zeros_like(listed)
    alpha = layers.opacity * torch.exp(-power)
    seen[order.numpy()] = (alpha > ALPHA_MIN * (1 + 1e-4)).T.reshape(-1, eye.height, eye.width).numpy()
    assert seen.any()
    assert not (seen & ~listed).any()
    rows = listed.any(2).sum(), (seen | np.roll(seen, 1, 1) | np.roll(seen, -1, 1)).any(2).sum()
    assert rows[0] < 3 * rows[1]


def test_backward_is_that_of_finite_differences() -> None:
    splat, eye = scene(12, -1.5), camera()
    view = view_of(eye, 0.01)
    draw = np.random.default_rng(0)
    weights = draw.normal(size=(12, 9)).astype(np.float32)
    by_hit_z, by_z, by_peak = draw.normal(size=(3, 12)).astype(np.float32)
    by_normal = draw.normal(size=(12, 3)).astype(np.float32)

    def loss(shape: Shape, scale: np.ndarray) -> float:
        """The divisor of C and D is held at the base's: the kernels take it as constant."""
        disks = project_disks(shape, view)
        geometry = disks.geometry.copy()
        geometry[:, 2:] *= (divisor(shape) / scale)[:, None]
        z0 = np.asarray(camera_z(shape))
        natural = np.log(1 / (1 + np.exp(-shape.opacity_logits.astype(np.float64))))
        total = (geometry * weights).sum() + (by_hit_z * geometry[:, 6] * z0).sum() + (by_z * z0).sum()
        return float(total + (by_peak * natural).sum() + (disks.normals * by_normal).sum())

    def camera_z(shape: Shape) -> np.ndarray:
        return (shape.means.astype(np.float64) @ view.rotation.T + view.translation)[:, 2]

    def divisor(shape: Shape) -> np.ndarray:
        """Largest projected half axis entry with D_0's sign, as `splat.disks` documents it."""
        R = view.rotation @ rotations(torch.from_numpy(shape.quaternions).double()).numpy()
        p = shape.means.astype(np.float64) @ view.rotation.T + view.translation
        t = R[:, :, :2] * np.exp(shape.log_scales.astype(np.float64))[:, None] / p[:, 2, None, None]
        a = view.fx * (p[:, :1] / p[:, 2:] * t[:, 2] - t[:, 0])
        b = view.fy * (p[:, 1:2] / p[:, 2:] * t[:, 2] - t[:, 1])
        largest = np.abs(np.concatenate([a, b], 1)).max(1)
        return largest * np.sign(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])

    base = shape_of(splat)
    fixed = divisor(base)
    image = np.zeros((12, 20), np.float32)
    image[:, 3:12], image[:, 15:18] = weights, by_normal
    image[:, 12:15] = np.stack([by_hit_z, by_z, by_peak], 1)
    wanted = camera_z(base) > 0.01
    found = project_disks_backward(base, view, wanted, image)
    for name in ("means", "log_scales", "quaternions", "opacity_logits"):
        gradient, values = getattr(found, name), getattr(base, name)
        for index in np.ndindex(*values.shape):
            if not wanted[index[0]]:
                assert not gradient[index]
                continue
            step = np.zeros_like(values)
            step[index] = 2.0**-11
            ahead = loss(base._replace(**{name: values + step}), fixed)
            behind = loss(base._replace(**{name: values - step}), fixed)
            moved = float((values + step)[index]) - float((values - step)[index])
            scale = float(np.abs(gradient[index[0]]).max())
            assert (ahead - behind) / moved == pytest.approx(float(gradient[index]), abs=5e-3 * scale + 1e-3), name


def test_culled_and_broken_disks_have_an_empty_footprint() -> None:
    splat = scene(5, -1.0)
    splat.means[:] = torch.tensor([0.0, 0.0, 2.0])
    splat.means[0, 2] = -1.0
    splat.means[1, 0] = torch.nan
    splat.log_scales[2] = torch.inf
    splat.quaternions[3] = 0.0
    splat.opacity_logits[4] = math.log((1 / 256) / (1 - 1 / 256))
    disks = project_disks(shape_of(splat), view_of(identity_camera(8, 8, 9.0), 0.01))
    assert not (disks.footprints[:, 2] > 0).any()


def test_normals_point_at_the_camera() -> None:
    splat, eye = scene(50, -1.5), camera()
    disks = project_disks(shape_of(splat), view_of(eye, 0.01))
    seen = disks.footprints[:, 2] > 0
    centres: Tensor = splat.means @ eye.rotation.T
    along = (disks.normals * centres.numpy()).sum(1)
    assert (along[seen] <= 0).all()
    np.testing.assert_allclose(np.linalg.norm(disks.normals[seen], axis=1), 1, rtol=1e-5)
