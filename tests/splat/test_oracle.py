"""The oracle against closed forms: everything else in this folder is held against the oracle."""

import dataclasses
import math

import pytest
import torch
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.methods import Method, MipSplatting, ThreeDGS, TwoDGS
from gaussian_enhancer.splat.oracle import SH_0, render_oracle, rotations, sh_values
from gaussian_enhancer.types import Camera, Gaussians, identity_camera

METHODS: list[Method] = [ThreeDGS(), MipSplatting(), TwoDGS()]
by_name = pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)


def logit(p: float) -> float:
    return math.log(p / (1 - p))


def single(axes: int, z: float = 2.0, scale: float = 0.1, opacity: float = 0.6, grey: float = 0.8) -> Gaussians:
    """One round Gaussian on the optical axis, facing the camera."""
    return Gaussians(
        means=torch.tensor([[0.0, 0.0, z]], dtype=torch.float64),
        log_scales=torch.full((1, axes), math.log(scale), dtype=torch.float64),
        quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64),
        opacity_logits=torch.tensor([logit(opacity)], dtype=torch.float64),
        sh=torch.full((1, 1, 3), (grey - 0.5) / SH_0, dtype=torch.float64),
    )


def axes_of(method: Method) -> int:
    return 2 if isinstance(method, TwoDGS) else 3


def stacked(*layers: Gaussians) -> Gaussians:
    names = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
    return Gaussians(*(torch.cat([getattr(layer, name) for layer in layers]) for name in names))


def random_scene(method: Method, count: int, seed: int = 0, degree_coefficients: int = 4) -> Gaussians:
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=draw, dtype=torch.float64)

    smoothing = 0.02 + 0.02 * torch.rand(count, generator=draw, dtype=torch.float64)
    return Gaussians(
        means=normal(count, 3) * torch.tensor([0.5, 0.5, 0.7]) + torch.tensor([0.0, 0.0, 3.0]),
        log_scales=normal(count, axes_of(method)) * 0.4 - 1.6,
        quaternions=normal(count, 4),
        opacity_logits=normal(count),
        sh=normal(count, degree_coefficients, 3) * 0.3,
        smoothing=smoothing if isinstance(method, MipSplatting) else None,
    )


def odd_camera(height: int = 9, width: int = 13) -> Camera:
    camera = identity_camera(height, width, 11.0, torch.float64)
    return dataclasses.replace(camera, K=camera.K + torch.tensor([[0.0, 0, 0.7], [0, 1.3, -0.4], [0, 0, 0]]))


def test_one_gaussian_has_its_known_width_and_peak() -> None:
    camera = identity_camera(21, 21, 60.0, torch.float64)
    alpha = render_oracle(single(3, z=2.0, scale=0.1), camera, ThreeDGS()).alpha[0]
    variance = (60.0 * 0.1 / 2.0) ** 2 + 0.3
    offset = torch.arange(21) - 10.0
    expected = 0.6 * torch.exp(-0.5 * (offset[:, None] ** 2 + offset**2) / variance)
    torch.testing.assert_close(alpha, torch.where(expected >= 1 / 255, expected, 0.0).double(), atol=1e-7, rtol=1e-6)


def test_facing_disk_is_the_gaussian_of_its_size() -> None:
    camera = identity_camera(21, 21, 60.0, torch.float64)
    disk = render_oracle(single(2), camera, TwoDGS())
    ball = render_oracle(single(3), camera, ThreeDGS(dilation=0.0))
    torch.testing.assert_close(disk.alpha, ball.alpha)
    torch.testing.assert_close(disk.colour, ball.colour)
    assert disk.normals is not None
    torch.testing.assert_close(disk.normals[:, 10, 10], torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64))


def test_tiny_disk_falls_back_to_the_low_pass() -> None:
    camera = identity_camera(5, 5, 60.0, torch.float64)
    alpha = render_oracle(single(2, scale=1e-6), camera, TwoDGS()).alpha[0]
    assert alpha[2, 3].item() == pytest.approx(0.6 * math.exp(-1.0))


@by_name
def test_opacity_stack_composites_to_one_minus_the_product(method: Method) -> None:
    peaks = (0.3, 0.5, 0.2)
    layers = stacked(*(single(axes_of(method), 2.0 + i, 0.5, a) for i, a in enumerate(peaks)))
    camera = identity_camera(3, 3, 60.0, torch.float64)
    view = render_oracle(layers, camera, method, (0.1, 0.2, 0.3))
    gone = math.prod(1 - a for a in peaks)
    assert view.alpha[0, 1, 1].item() == pytest.approx(1 - gone, rel=1e-3)
    background = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    torch.testing.assert_close(view.colour[:, 1, 1], 0.8 * view.alpha[0, 1, 1] + gone * background, rtol=1e-3, atol=0)


@by_name
def test_depth_of_one_plane_is_exact_and_median_is_where_half_is_gone(method: Method) -> None:
    axes = axes_of(method)
    camera = identity_camera(7, 9, 20.0, torch.float64)
    view = render_oracle(single(axes, 3.25, 5.0, 0.9), camera, method)
    torch.testing.assert_close(view.depth, torch.full((1, 7, 9), 3.25, dtype=torch.float64))
    stack = stacked(*(single(axes, z, 5.0, 0.3) for z in (1.0, 2.0, 3.0, 4.0)))
    median = render_oracle(stack, camera, method).median_depth
    assert median is not None
    assert median[0, 3, 4].item() == 2.0
    faint = render_oracle(single(axes, 3.25, 5.0, 0.4), camera, method).median_depth
    assert faint is not None
    assert not faint.any()


def test_disk_depth_is_that_of_the_tilted_plane() -> None:
    angle = 0.7
    disk = dataclasses.replace(
        single(2, 3.0, 2.0, 0.9),
        quaternions=torch.tensor([[math.cos(angle / 2), 0, math.sin(angle / 2), 0]], dtype=torch.float64),
    )
    camera = identity_camera(9, 9, 20.0, torch.float64)
    depth = render_oracle(disk, camera, TwoDGS()).depth[0, 4]
    x = (torch.arange(9) + 0.5 - 4.5).double() / 20.0
    torch.testing.assert_close(depth, 3.0 / (1 + x * math.tan(angle)))


def test_mip_compensation_keeps_the_energy_of_a_subpixel_gaussian() -> None:
    scale, focal, z = 0.01, 60.0, 2.0
    small = single(3, z, scale, 0.9)
    camera = identity_camera(11, 11, focal, torch.float64)
    sampled = render_oracle(small, camera, MipSplatting(dilation=1.0)).alpha.sum().item()
    variance = (focal * scale / z) ** 2
    true = 0.9 * 2 * math.pi * variance
    cut_off = 2 * math.pi * (variance + 1) / 255  # what lies below 1/255 is not drawn
    assert sampled == pytest.approx(true - cut_off, rel=0.05)
    assert render_oracle(small, camera, ThreeDGS(dilation=1.0)).alpha.sum().item() > 5 * true


def test_smoothing_widens_in_3d_and_lowers_opacity() -> None:
    smooth = dataclasses.replace(single(3, 2.0, 0.1, 0.6), smoothing=torch.tensor([0.2], dtype=torch.float64))
    wide = single(3, 2.0, math.hypot(0.1, 0.2), 0.6 * (0.1 / math.hypot(0.1, 0.2)) ** 3)
    camera = identity_camera(9, 9, 60.0, torch.float64)
    method = MipSplatting()
    torch.testing.assert_close(render_oracle(smooth, camera, method).colour, render_oracle(wide, camera, method).colour)


@by_name
def test_gradients_are_those_of_finite_differences(method: Method) -> None:
    scene = random_scene(method, 5, seed=3)
    camera = odd_camera(4, 5)
    leaves = (scene.means, scene.log_scales, scene.quaternions, scene.opacity_logits, scene.sh)

    def outputs(*values: Tensor) -> tuple[Tensor, ...]:
        view = render_oracle(Gaussians(*values, smoothing=scene.smoothing), camera, method, (0.2, 0.4, 0.6))
        seen = view.alpha > 0.05
        smooth = (view.colour, view.depth * seen, view.alpha)
        return smooth if view.normals is None else (*smooth, view.normals * seen)

    assert torch.autograd.gradcheck(outputs, tuple(x.clone().requires_grad_() for x in leaves), eps=1e-7, atol=1e-4)


@by_name
def test_moving_world_and_camera_together_changes_nothing(method: Method) -> None:
    scene = random_scene(method, 30, degree_coefficients=1)
    camera = odd_camera()
    turn = rotations(torch.tensor([[0.3, -0.8, 0.4, 0.6]], dtype=torch.float64))[0]
    shift = torch.tensor([5.0, -2.0, 1.0], dtype=torch.float64)
    motion = torch.eye(4, dtype=torch.float64)
    motion[:3, :3], motion[:3, 3] = turn, shift
    w, x, y, z = (torch.tensor([0.3, -0.8, 0.4, 0.6], dtype=torch.float64)).unbind()
    product = torch.stack([w, -x, -y, -z, x, w, -z, y, y, z, w, -x, z, -y, x, w]).reshape(4, 4)
    moved = dataclasses.replace(scene, means=scene.means @ turn.T + shift, quaternions=scene.quaternions @ product.T)
    seen = dataclasses.replace(camera, world_to_camera=camera.world_to_camera @ torch.linalg.inv(motion))
    before, after = render_oracle(scene, camera, method), render_oracle(moved, seen, method)
    torch.testing.assert_close(after.colour, before.colour)
    torch.testing.assert_close(after.depth, before.depth)
    if before.normals is not None:
        torch.testing.assert_close(after.normals, before.normals)


@by_name
@pytest.mark.parametrize("unit", [1e-4, 1e6])
def test_the_scene_unit_does_not_matter(method: Method, unit: float) -> None:
    scene = random_scene(method, 30)
    smoothing = None if scene.smoothing is None else scene.smoothing * unit
    scaled = dataclasses.replace(
        scene, means=scene.means * unit, log_scales=scene.log_scales + math.log(unit), smoothing=smoothing
    )
    before = render_oracle(scene, odd_camera(), method, near=0.01)
    after = render_oracle(scaled, odd_camera(), method, near=0.01 * unit)
    torch.testing.assert_close(after.colour, before.colour)
    torch.testing.assert_close(after.depth, before.depth * unit)


@by_name
def test_nothing_in_front_gives_the_background(method: Method) -> None:
    behind = stacked(single(axes_of(method), -1.0), single(axes_of(method), 0.0), single(axes_of(method), 0.01))
    empty = behind[torch.zeros(3, dtype=torch.bool)]
    for scene in (behind, empty):
        view = render_oracle(scene, odd_camera(), method, (0.1, 0.2, 0.3))
        assert not view.alpha.any()
        assert not view.depth.any()
        assert view.colour[2].eq(0.3).all()


@by_name
def test_chunks_of_pixels_change_nothing(method: Method, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = random_scene(method, 20)
    scene.means.requires_grad_()
    whole = render_oracle(scene, odd_camera(), method)
    (wanted,) = torch.autograd.grad(whole.colour.square().sum(), scene.means)
    monkeypatch.setattr("gaussian_enhancer.splat.oracle.CHUNK_ELEMENTS", 200)
    parts = render_oracle(scene, odd_camera(), method)
    (got,) = torch.autograd.grad(parts.colour.square().sum(), scene.means)
    torch.testing.assert_close(parts.colour, whole.colour)
    torch.testing.assert_close(got, wanted)


@by_name
def test_needles_and_edge_on_disks_have_finite_gradients(method: Method) -> None:
    scene = random_scene(method, 20)
    scene.log_scales[:, 0] = math.log(1e-6)
    scene.log_scales[:10, 1] = 0.0
    scene.means[0] = torch.tensor([0.0, 0.0, 2.0])
    scene.quaternions[0] = torch.tensor([math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0])
    leaves = [scene.means, scene.log_scales, scene.quaternions, scene.opacity_logits, scene.sh]
    for leaf in leaves:
        leaf.requires_grad_()
    view = render_oracle(scene, odd_camera(), method)
    gradients = torch.autograd.grad((view.colour + view.depth + view.alpha).square().sum(), leaves)
    assert all(gradient.isfinite().all() for gradient in gradients)


def test_spherical_harmonics_are_orthonormal() -> None:
    draw = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(200_000, 3, generator=draw, dtype=torch.float64), dim=-1)
    unit = torch.zeros(1, 16, 16, 3, dtype=torch.float64)
    unit[0] = torch.eye(16, dtype=torch.float64)[..., None]
    values = torch.stack([sh_values(unit[:, i].expand(len(directions), 16, 3), directions)[:, 0] for i in range(16)])
    product = 4 * math.pi * values @ values.T / len(directions)
    torch.testing.assert_close(product, torch.eye(16, dtype=torch.float64), atol=0.03, rtol=0)


@by_name
def test_scale_axes_that_do_not_suit_the_method_are_refused(method: Method) -> None:
    with pytest.raises(InputError, match=r"scale axes.*another method"):
        render_oracle(single(5 - axes_of(method)), odd_camera(), method)
