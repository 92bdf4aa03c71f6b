"""The whole renderer against the float64 twin: values and the gradients of all five tensors, easy and stiff scenes."""

import dataclasses

import numpy as np
import pytest
import torch
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.methods import Method, MipSplatting, ThreeDGS, TwoDGS
from gaussian_enhancer.splat.oracle import render_oracle
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.splat.screen import ScreenStatistics
from gaussian_enhancer.types import Camera, Gaussians, Render, identity_camera

LEARNT = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
BACKGROUND = (0.2, 0.5, 0.1)
ellipsoids = pytest.mark.parametrize("method", [ThreeDGS(), MipSplatting()], ids=lambda method: method.name)


def scene(count: int, coefficients: int = 4, scale: float = 0.05, seed: int = 0) -> Gaussians:
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=draw)

    return Gaussians(
        means=normal(count, 3) * torch.tensor([0.8, 0.8, 1.0]) + torch.tensor([0.0, 0.0, 3.0]),
        log_scales=normal(count, 3) * 0.7 + float(np.log(scale)),
        quaternions=normal(count, 4),
        opacity_logits=normal(count) * 2,
        sh=normal(count, coefficients, 3) * 0.3,
        smoothing=torch.rand(count, generator=draw) * 0.02,
    )


def turned_camera(height: int, width: int) -> Camera:
    """Off the axis, unequal focal lengths, principal point beside the middle."""
    pose = torch.eye(4)
    pose[:3, :3] = torch.linalg.matrix_exp(torch.tensor([[0, -0.1, 0.2], [0.1, 0, -0.15], [-0.2, 0.15, 0]]))
    pose[:3, 3] = torch.tensor([0.1, -0.2, 0.3])
    K = torch.tensor([[1.1 * width, 0, 0.45 * width], [0, 1.3 * height, 0.6 * height], [0, 0, 1.0]])
    return Camera(K, pose, height, width)


def learning(gaussians: Gaussians, dtype: torch.dtype) -> Gaussians:
    gaussians = gaussians.to(dtype)
    return dataclasses.replace(
        gaussians, **{name: getattr(gaussians, name).clone().requires_grad_() for name in LEARNT}
    )


def pulled(image: Render, seed: int = 5) -> None:
    """Backward from a random mix of colour, depth and alpha."""
    draw = torch.Generator().manual_seed(seed)
    planes = (image.colour, image.depth, image.alpha)
    sum((torch.randn(plane.shape, generator=draw).to(plane) * plane).sum() for plane in planes).backward()  # type: ignore[union-attr]


def both(gaussians: Gaussians, camera: Camera, method: Method) -> tuple[Gaussians, Gaussians, Render, Render]:
    fast, exact = learning(gaussians, torch.float32), learning(gaussians, torch.float64)
    image = render(fast, camera, method, BACKGROUND)
    truth = render_oracle(exact, camera.to(torch.float64), method, BACKGROUND)
    pulled(image)
    pulled(truth)
    return fast, exact, image, truth


def assert_equal_to_the_oracle(
    gaussians: Gaussians, camera: Camera, method: Method, value: float = 1e-4, gradient: float = 1e-3
) -> None:
    """A pixel whose alpha or transmittance lies on a threshold may fall to either side: one in 1000 is allowed."""
    fast, exact, image, truth = both(gaussians, camera, method)
    for name in ("colour", "alpha", "depth", "median_depth"):
        error = (getattr(image, name).double() - getattr(truth, name)).abs() / (1 + getattr(truth, name).abs())
        assert (error > value).double().mean() <= 1e-3, f"{name}: {error.max()}"
    for name in LEARNT:
        found, expected = getattr(fast, name).grad.double(), getattr(exact, name).grad
        assert found.isfinite().all(), name
        assert (found - expected).norm() <= gradient * expected.norm() + 1e-4, name


@ellipsoids
@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_equals_the_oracle(method: Method, coefficients: int) -> None:
    assert_equal_to_the_oracle(scene(200, coefficients, seed=coefficients), turned_camera(40, 56), method)


@ellipsoids
@pytest.mark.parametrize(("height", "width"), [(1, 1), (17, 33), (1, 40), (31, 2)])
def test_odd_sizes(method: Method, height: int, width: int) -> None:
    assert_equal_to_the_oracle(scene(60, scale=0.15), turned_camera(height, width), method)


@ellipsoids
def test_huge_and_tiny(method: Method) -> None:
    gaussians = scene(80)
    gaussians.log_scales[:20] += 5.0
    gaussians.log_scales[20:40] -= 6.0
    gaussians.opacity_logits[:20] -= 2.0
    assert_equal_to_the_oracle(gaussians, turned_camera(32, 32), method)


@ellipsoids
def test_around_the_camera_and_at_the_near_plane(method: Method) -> None:
    gaussians = scene(120, scale=0.02)
    gaussians.means[:, 2] -= 3.0
    gaussians.means[:10, 2] = 0.011
    gaussians.means[10:20, 2] = 0.01
    camera = identity_camera(24, 24, 20.0)
    assert_equal_to_the_oracle(gaussians, camera, method, value=1e-3, gradient=5e-3)
    fast, _, _, _ = both(gaussians, camera, method)
    assert fast.means.grad is not None
    assert (fast.means.grad[gaussians.means[:, 2] <= 0.01] == 0).all()


@ellipsoids
def test_opaque_stacks(method: Method) -> None:
    gaussians = scene(60, scale=0.3)
    gaussians.opacity_logits[:] = 30.0
    assert_equal_to_the_oracle(gaussians, turned_camera(24, 24), method)


@ellipsoids
def test_needles_stay_finite_and_right(method: Method) -> None:
    gaussians = scene(40)
    gaussians.log_scales[:] = torch.log(torch.tensor([1e3, 1e-3, 1e-3]))
    gaussians.opacity_logits[:] = 3.0
    image = render(gaussians, turned_camera(32, 32), method)
    assert_equal_to_the_oracle(gaussians, turned_camera(32, 32), method, value=1e-3, gradient=1e-2)
    assert image.alpha.max() > 0.05


@ellipsoids
def test_one_and_none(method: Method) -> None:
    camera = turned_camera(17, 33)
    one = scene(1, scale=0.2)
    one.means[:] = torch.tensor([0.0, 0.0, 3.0])
    assert_equal_to_the_oracle(one, camera, method)
    empty = learning(scene(0), torch.float32)
    image = render(empty, camera, method, BACKGROUND)
    assert torch.equal(image.colour, torch.tensor(BACKGROUND)[:, None, None].expand(3, 17, 33))
    assert image.alpha.max() == 0
    pulled(image)
    assert empty.means.grad is not None
    assert empty.means.grad.shape == (0, 3)


def test_gaussians_that_are_not_finite_are_left_out() -> None:
    gaussians, camera = scene(30), turned_camera(24, 24)
    expected = render(gaussians[torch.arange(30) >= 5], camera, ThreeDGS())
    for name in ("means", "log_scales", "quaternions"):
        broken = learning(gaussians, torch.float32)
        with torch.no_grad():
            getattr(broken, name)[:5] = torch.tensor([torch.nan, torch.inf, -torch.inf, torch.nan, 1e30])[:, None]
        image = render(broken, camera, ThreeDGS())
        if name == "means":
            torch.testing.assert_close(image.colour, expected.colour)
        assert image.colour.isfinite().all()
        pulled(image)
        assert all(getattr(broken, each).grad.isfinite().all() for each in LEARNT)


def test_float64_is_the_oracle() -> None:
    gaussians, camera = scene(20).to(torch.float64), turned_camera(16, 16).to(torch.float64)
    image = render(gaussians, camera, ThreeDGS(), BACKGROUND)
    assert image.colour.dtype == torch.float64
    assert torch.equal(image.colour, render_oracle(gaussians, camera, ThreeDGS(), BACKGROUND).colour)


def test_strided_parameters_and_threads_do_not_change_the_image() -> None:
    import numba

    gaussians, camera = scene(200), turned_camera(40, 56)
    strided = dataclasses.replace(gaussians, means=gaussians.means.T.contiguous().T)
    expected = render(gaussians, camera, ThreeDGS()).colour
    assert torch.equal(render(strided, camera, ThreeDGS()).colour, expected)
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        assert torch.equal(render(gaussians, camera, ThreeDGS()).colour, expected)
    finally:
        numba.set_num_threads(before)


def test_screen_statistics() -> None:
    gaussians, camera = learning(scene(100), torch.float32), identity_camera(40, 40, 40.0)
    with torch.no_grad():
        gaussians.means[0] = torch.tensor([0.0, 0.0, -1.0])
        gaussians.means[1] = torch.tensor([0.0, 0.0, 2.0])
        gaussians.log_scales[1] = float(np.log(0.1))
        gaussians.opacity_logits[1] = 2.0
    screen = ScreenStatistics()
    image = render(gaussians, camera, ThreeDGS(), screen=screen)
    assert screen.visible is not None
    assert not screen.visible[0]
    assert screen.visible[1]
    assert screen.gradient is None
    image.colour.square().sum().backward()
    assert screen.gradient is not None
    assert (screen.gradient[~screen.visible] == 0).all()


def test_the_screen_gradient_is_that_of_the_centre_on_the_image() -> None:
    """Moving a frontal Gaussian sideways by z / focal moves it by one pixel."""
    gaussians = learning(scene(1), torch.float32)
    with torch.no_grad():
        gaussians.means[:] = torch.tensor([[0.02, 0.01, 2.0]])
        gaussians.log_scales[:] = float(np.log(0.1))
        gaussians.sh[:, 1:] = 0
    screen = ScreenStatistics()
    image = render(gaussians, identity_camera(32, 32, 1000.0), ThreeDGS(), screen=screen)
    (image.colour * torch.linspace(0, 1, 32)).sum().backward()
    assert gaussians.means.grad is not None
    assert screen.gradient is not None
    sideways = gaussians.means.grad[0, :2].norm() * 2.0 / 1000.0
    assert screen.gradient[0] == pytest.approx(float(sideways), rel=0.02)


def test_changing_a_parameter_between_forward_and_backward_is_refused() -> None:
    gaussians = learning(scene(10), torch.float32)
    image = render(gaussians, turned_camera(16, 16), ThreeDGS())
    with torch.no_grad():
        gaussians.means.add_(1.0)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        image.colour.sum().backward()


def test_refusals() -> None:
    gaussians, camera = scene(3), turned_camera(8, 8)
    with pytest.raises(InputError, match="3 scale axes"):
        render(gaussians, camera, TwoDGS())
    with pytest.raises(InputError, match="2 scale axes"):
        render(dataclasses.replace(gaussians, log_scales=gaussians.log_scales[:, :2]), camera, ThreeDGS())
    with pytest.raises(InputError, match="5 spherical-harmonics"):
        render(dataclasses.replace(gaussians, sh=torch.zeros(3, 5, 3)), camera, ThreeDGS())
    with pytest.raises(InputError, match="not negative"):
        render(gaussians, camera, ThreeDGS(), near=-1.0)
    with pytest.raises(InputError, match="0x8"):
        render(gaussians, dataclasses.replace(camera, width=0), ThreeDGS())
    with pytest.raises(InputError, match="float32"):
        render(gaussians.to(torch.float64), camera.to(torch.float64), ThreeDGS(), screen=ScreenStatistics())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("method", [ThreeDGS(), TwoDGS(), MipSplatting()], ids=lambda method: method.name)
@pytest.mark.parametrize(
    ("field", "value"),
    [
        *[("sh", value) for value in (float("nan"), float("inf"), 1e30)],
        *[("log_scales", value) for value in (90.0, 200.0, -1000.0, -1e30, float("nan"))],
        *[(field, float("nan")) for field in ("means", "quaternions", "opacity_logits", "smoothing")],
        ("quaternions", 0.0),
    ],
)
def test_a_parameter_that_cannot_be_rendered_hides_its_gaussian(method, field, value, dtype) -> None:
    good, camera = scene(6).to(dtype), turned_camera(20, 24)
    if isinstance(method, TwoDGS):
        good = dataclasses.replace(good, log_scales=good.log_scales[:, :2])
    broken = dataclasses.replace(good, **{field: getattr(good, field).clone()})
    getattr(broken, field)[2] = value
    for each in LEARNT:
        getattr(broken, each).requires_grad_()
    image = render(broken, camera, method)
    without = render(good[torch.tensor([0, 1, 3, 4, 5])], camera, method)
    torch.testing.assert_close(image.colour, without.colour)
    torch.testing.assert_close(image.depth, without.depth)
    (image.colour.square().sum() + image.depth.sum() + image.alpha.sum()).backward()
    for each in LEARNT:
        gradient = getattr(broken, each).grad
        assert bool(gradient.isfinite().all()), each
        assert not bool(gradient[2].any()), each
