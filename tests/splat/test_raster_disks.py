"""The compiled disk kernels against the oracle: values, gradients, and what must not matter."""

import dataclasses
import math

import pytest
import torch
from torch import Tensor

from gaussian_enhancer.splat.methods import TwoDGS
from gaussian_enhancer.splat.oracle import render_oracle
from gaussian_enhancer.splat.render_disks import render_disks
from gaussian_enhancer.splat.screen import ScreenStatistics
from gaussian_enhancer.types import Camera, Gaussians, Render, identity_camera

LEARNT = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
BACKGROUND = (0.2, 0.5, 0.7)


def scene(count: int, seed: int = 0, size: float = -2.5, spread: float = 0.6, coefficients: int = 4) -> Gaussians:
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=draw)

    return Gaussians(
        means=normal(count, 3) * torch.tensor([0.8, 0.8, 0.7]) + torch.tensor([0.0, 0.0, 3.0]),
        log_scales=normal(count, 2) * spread + size,
        quaternions=normal(count, 4),
        opacity_logits=normal(count),
        sh=normal(count, coefficients, 3) * 0.3,
    )


def camera(height: int = 37, width: int = 53, focal: float = 45.0) -> Camera:
    plain = identity_camera(height, width, focal)
    return dataclasses.replace(plain, K=plain.K + torch.tensor([[0.0, 0, 2.7], [0, 3.0, -1.4], [0, 0, 0]]))


def cotangents(height: int, width: int) -> tuple[Tensor, ...]:
    draw = torch.Generator().manual_seed(9)
    return tuple(torch.randn(c, height, width, generator=draw) for c in (3, 1, 1, 3))


def planes(view: Render) -> tuple[Tensor, ...]:
    assert view.normals is not None
    return view.colour, view.depth, view.alpha, view.normals


def with_gradients(render: object, splat: Gaussians, eye: Camera, dtype: torch.dtype) -> tuple[Render, list[Tensor]]:
    """Render in a dtype and pull fixed cotangents back; those of depth and normals only well above alpha's cut."""
    leaves = {name: getattr(splat, name).to(dtype).requires_grad_() for name in LEARNT}
    args = (Gaussians(**leaves), eye.to(dtype))
    view = render_disks(*args, BACKGROUND) if render is render_disks else render_oracle(*args, TwoDGS(), BACKGROUND)
    solid = view.alpha.detach() > 0.01
    colour, depth, alpha, normals = (c.to(dtype) for c in cotangents(eye.height, eye.width))
    weights = (colour, depth * solid, alpha, normals * solid)
    loss = sum((a * b).sum() for a, b in zip(planes(view), weights, strict=True))
    return view, list(torch.autograd.grad(loss, list(leaves.values())))


def worst(got: Tensor, wanted: Tensor) -> float:
    """Largest error over the tensor's own scale."""
    return float((got.double() - wanted).abs().max() / wanted.abs().max().clamp_min(1e-12))


def disagreeing(got: Tensor, wanted: Tensor, tolerance: float) -> float:
    """Share of pixels that differ: a threshold on alpha may fall either way in another precision."""
    return float(((got.double() - wanted).abs() > tolerance * (1 + wanted.abs())).double().mean())


@pytest.mark.parametrize(
    "splat",
    [scene(60), scene(200, 1, -3.5), scene(40, 2, -1.0), scene(60, 3, -2.5, 2.0), scene(30, 4, -6.0)],
    ids=["usual", "small", "large", "elongated", "subpixel"],
)
def test_values_and_gradients_are_the_oracles(splat: Gaussians) -> None:
    got, got_gradients = with_gradients(render_disks, splat, camera(), torch.float32)
    wanted, wanted_gradients = with_gradients(render_oracle, splat, camera(), torch.float64)
    for a, b in zip(planes(got), planes(wanted), strict=True):
        assert disagreeing(a, b, 2e-4) < 2e-3
    assert got.median_depth is not None
    assert wanted.median_depth is not None
    assert disagreeing(got.median_depth, wanted.median_depth, 1e-4) < 5e-3
    for name, a, b in zip(LEARNT, got_gradients, wanted_gradients, strict=True):
        assert worst(a, b) < 5e-3, name


def test_screen_gradient_is_that_of_moving_the_image_under_the_disk() -> None:
    splat, eye = scene(1, 3, -1.5), camera()
    screen = ScreenStatistics()
    leaves = {name: getattr(splat, name).clone().requires_grad_() for name in LEARNT}
    view = render_disks(Gaussians(**leaves), eye, BACKGROUND, screen=screen)
    colour = cotangents(eye.height, eye.width)[0]
    (view.colour * colour).sum().backward()
    K = eye.K.double().requires_grad_()
    twin = render_oracle(splat.to(torch.float64), dataclasses.replace(eye.to(torch.float64), K=K), TwoDGS(), BACKGROUND)
    (gradient,) = torch.autograd.grad((twin.colour * colour.double()).sum(), K)
    assert screen.gradient is not None
    assert screen.visible is not None
    assert screen.gradient.item() == pytest.approx(gradient[:2, 2].norm().item(), rel=1e-3)
    assert screen.visible.tolist() == [True]


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 40), (33, 1), (16, 16), (17, 15)])
def test_any_image_size_agrees_with_the_oracle(height: int, width: int) -> None:
    eye = camera(height, width, 20.0)
    got = render_disks(scene(60), eye, BACKGROUND)
    wanted = render_oracle(scene(60).to(torch.float64), eye.to(torch.float64), TwoDGS(), BACKGROUND)
    assert disagreeing(got.colour, wanted.colour, 2e-4) < 0.02


def edge_on(count: int) -> Gaussians:
    """Disks whose plane holds the camera, some exactly, some nearly, among them one around the camera's own axis."""
    splat = scene(count, 5, -1.0)
    splat.quaternions[:] = torch.tensor([math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0])
    splat.means[: count // 2, 0] = 0.0
    splat.means[0] = torch.tensor([0.0, 0.0, 2.0])
    splat.quaternions[count // 4 : count // 2] += 1e-4
    return splat


def test_disks_seen_edge_on_stay_finite_and_agree() -> None:
    got, gradients = with_gradients(render_disks, edge_on(24), camera(), torch.float32)
    wanted, _ = with_gradients(render_oracle, edge_on(24), camera(), torch.float64)
    assert disagreeing(got.colour, wanted.colour, 1e-3) < 0.01
    assert got.alpha.max() > 0.1
    assert all(gradient.isfinite().all() for gradient in gradients)


def test_needles_of_axis_ratio_a_million_stay_finite_and_agree() -> None:
    splat = scene(60)
    splat.log_scales[:, 0] = math.log(0.5)
    splat.log_scales[:, 1] = math.log(0.5e-6)
    got, gradients = with_gradients(render_disks, splat, camera(), torch.float32)
    wanted, wanted_gradients = with_gradients(render_oracle, splat, camera(), torch.float64)
    assert disagreeing(got.colour, wanted.colour, 2e-4) < 2e-3
    for name, a, b in zip(LEARNT, gradients, wanted_gradients, strict=True):
        assert a.isfinite().all()
        assert worst(a, b) < 5e-3, name


def test_disks_around_the_camera_and_the_near_plane_agree() -> None:
    splat = scene(40, 6, 0.5)
    splat.means[:, 2] = torch.linspace(-0.5, 1.5, 40)
    splat.means[7, 2] = 0.01
    got, gradients = with_gradients(render_disks, splat, camera(), torch.float32)
    wanted, wanted_gradients = with_gradients(render_oracle, splat, camera(), torch.float64)
    assert disagreeing(got.colour, wanted.colour, 1e-3) < 5e-3
    assert disagreeing(got.depth, wanted.depth, 1e-3) < 5e-3
    for name, a, b in zip(LEARNT, gradients, wanted_gradients, strict=True):
        assert a.isfinite().all()
        assert worst(a, b) < 2e-2, name


@pytest.mark.parametrize("focal", [1.0, 1e5])
def test_extreme_focal_lengths_agree(focal: float) -> None:
    splat = scene(60)
    if focal > 1e3:
        splat = dataclasses.replace(splat, means=splat.means * torch.tensor([1e-3, 1e-3, 1.0]))
    got = render_disks(splat, camera(20, 30, focal), BACKGROUND)
    wanted = render_oracle(splat.to(torch.float64), camera(20, 30, focal).to(torch.float64), TwoDGS(), BACKGROUND)
    assert disagreeing(got.colour, wanted.colour, 1e-3) < 0.01


def test_nothing_in_front_gives_the_background_and_no_gradient() -> None:
    splat = scene(5)
    splat.means[:, 2] = torch.tensor([-3.0, -1.0, 0.0, 0.01, torch.nan])
    for behind in (splat, splat[torch.zeros(5, dtype=torch.bool)]):
        leaves = {name: getattr(behind, name).clone().requires_grad_() for name in LEARNT}
        view = render_disks(Gaussians(**leaves), camera(), BACKGROUND)
        assert not view.alpha.any()
        assert view.colour[1].eq(0.5).all()
        for gradient in torch.autograd.grad((view.colour.sum() + view.depth.sum()), list(leaves.values())):
            assert not gradient.any()


def test_rendering_twice_gives_the_same_bits() -> None:
    first, gradients = with_gradients(render_disks, scene(200), camera(), torch.float32)
    second, again = with_gradients(render_disks, scene(200), camera(), torch.float32)
    assert all(torch.equal(a, b) for a, b in zip(planes(first), planes(second), strict=True))
    assert all(torch.equal(a, b) for a, b in zip(gradients, again, strict=True))


def test_an_opaque_stack_stops_like_the_oracle() -> None:
    splat = scene(300, 8, 0.0)
    splat.opacity_logits[:] = 9.0
    got, gradients = with_gradients(render_disks, splat, camera(), torch.float32)
    wanted, wanted_gradients = with_gradients(render_oracle, splat, camera(), torch.float64)
    assert disagreeing(got.colour, wanted.colour, 1e-3) < 5e-3
    for name, a, b in zip(LEARNT, gradients, wanted_gradients, strict=True):
        assert worst(a, b) < 2e-2, name


def test_a_render_without_backward_leaves_no_screen_gradient_of_the_render_before() -> None:
    splat, eye, screen = scene(5, 3, -1.5), camera(), ScreenStatistics()
    leaves = {name: getattr(splat, name).clone().requires_grad_() for name in LEARNT}
    render_disks(Gaussians(**leaves), eye, BACKGROUND, screen=screen).colour.sum().backward()
    assert screen.gradient is not None
    render_disks(Gaussians(**leaves), eye, BACKGROUND, screen=screen)
    assert screen.gradient is None
