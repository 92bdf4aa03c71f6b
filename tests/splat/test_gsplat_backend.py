"""How gsplat is called, checked with a stand-in on the CPU; and on CUDA, what comes back, against the oracle."""

import dataclasses
import importlib.util
import sys
import types
from typing import Any

import pytest
import torch
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.gsplat_backend import render_gsplat
from gaussian_enhancer.splat.methods import Method, MipSplatting, ThreeDGS, TwoDGS
from gaussian_enhancer.splat.oracle import render_oracle, rotations
from gaussian_enhancer.splat.screen import ScreenStatistics
from gaussian_enhancer.types import Camera, Gaussians, identity_camera

METHODS: list[Method] = [ThreeDGS(), MipSplatting(), TwoDGS()]
by_name = pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
HEIGHT, WIDTH = 24, 40


def scene(method: Method, count: int = 50) -> Gaussians:
    draw = torch.Generator().manual_seed(0)
    axes = 2 if isinstance(method, TwoDGS) else 3
    return Gaussians(
        means=torch.randn(count, 3, generator=draw) * 0.6 + torch.tensor([0.0, 0.0, 3.0]),
        log_scales=torch.randn(count, axes, generator=draw) * 0.3 - 2.0,
        quaternions=torch.randn(count, 4, generator=draw),
        opacity_logits=torch.randn(count, generator=draw),
        sh=torch.randn(count, 9, 3, generator=draw) * 0.3,
        smoothing=torch.rand(count, generator=draw) * 0.05 if isinstance(method, MipSplatting) else None,
    )


def camera() -> Camera:
    plain = identity_camera(HEIGHT, WIDTH, 30.0)
    pose = torch.eye(4)
    pose[:3, :3] = rotations(torch.tensor([[1.0, 0.05, -0.1, 0.2]]))[0]
    return dataclasses.replace(plain, world_to_camera=pose)


class StandIn(types.ModuleType):
    """gsplat with constant images: alpha 0.6 left, 0.0004 right, colour 0.3, depth 2, median 1.5, normal world -z."""

    def __init__(self) -> None:
        super().__init__("gsplat")
        self.called: dict[str, Any] = {}

    def _common(self, arguments: dict[str, Any]) -> tuple[Tensor, Tensor, dict[str, Any]]:
        self.called = arguments
        size = (1, arguments["height"], arguments["width"])
        alphas = torch.full((*size, 1), 0.6)
        alphas[:, :, size[2] // 2 :] = 0.0004
        planes = torch.tensor([0.3, 0.3, 0.3, 2.0]).expand(*size, 4) + 0 * arguments["means"].sum()
        count = len(arguments["means"])
        radii = torch.full((1, count, 2), 7, dtype=torch.int32)
        radii[0, 0] = 0
        means2d = arguments["means"][None, :, :2] * 1.0
        return planes + 0 * means2d.sum(), alphas, {"radii": radii, "means2d": means2d}

    def rasterization(self, **arguments: Any) -> tuple[Tensor, Tensor, dict[str, Any]]:
        return self._common(arguments)

    def rasterization_2dgs(self, **arguments: Any) -> tuple[Any, ...]:
        planes, alphas, meta = self._common(arguments)
        meta["gradient_2dgs"] = torch.zeros(1, len(arguments["means"]), 2, requires_grad=True)
        normals = torch.tensor([0.0, 0.0, -0.6]).expand(*planes.shape[:3], 3)
        planes = planes + 0 * meta["gradient_2dgs"].sum()
        return planes, alphas, normals, normals, alphas, 1.5 + 0 * alphas, meta


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> StandIn:
    module = StandIn()
    monkeypatch.setitem(sys.modules, "gsplat", module)
    return module


@by_name
def test_tensors_are_handed_over_as_gsplat_wants_them(method: Method, library: StandIn) -> None:
    splat = scene(method)
    render_gsplat(splat, camera(), method, near=0.05)
    called = library.called
    expected = {"width": WIDTH, "height": HEIGHT, "sh_degree": 2, "near_plane": 0.05, "render_mode": "RGB+ED"}
    assert {name: called[name] for name in expected} == expected
    assert called["packed"] is False
    assert called["means"] is splat.means
    assert called["quats"] is splat.quaternions
    assert called["colors"] is splat.sh
    assert torch.equal(called["viewmats"], camera().world_to_camera[None])
    assert torch.equal(called["Ks"], camera().K[None])
    scales, opacities = splat.log_scales.exp(), splat.opacity_logits.sigmoid()
    if splat.smoothing is not None:
        wide = (scales.square() + splat.smoothing[:, None].square()).sqrt()
        opacities = opacities * (scales.square().prod(-1) / wide.square().prod(-1)).sqrt()
        scales = wide
    assert called["scales"].shape == (50, 3)
    torch.testing.assert_close(called["scales"][:, : scales.shape[1]], scales)
    torch.testing.assert_close(called["opacities"], opacities)
    if not isinstance(method, TwoDGS):
        assert called["eps2d"] == method.dilation
        assert called["rasterize_mode"] == ("antialiased" if isinstance(method, MipSplatting) else "classic")


@by_name
def test_images_come_back_in_this_package_s_conventions(method: Method, library: StandIn) -> None:
    view = render_gsplat(scene(method), camera(), method, (1.0, 0.5, 0.0))
    torch.testing.assert_close(view.colour[:, 0, 0], torch.tensor([0.7, 0.5, 0.3]))
    assert view.alpha.shape == (1, HEIGHT, WIDTH)
    assert view.depth[0, 0, 0] == 2
    assert view.depth[0, 0, -1] == 0
    if isinstance(method, TwoDGS):
        assert view.normals is not None
        assert view.median_depth is not None
        torch.testing.assert_close(view.normals[:, 0, 0], -camera().rotation[:, 2])
        assert not view.normals[:, 0, -1].any()
        assert view.median_depth[0, 0, 0] == 1.5
        assert view.median_depth[0, 0, -1] == 0


@by_name
def test_statistics_are_filled_by_forward_and_backward(method: Method, library: StandIn) -> None:
    splat = scene(method)
    splat.means.requires_grad_()
    screen = ScreenStatistics()
    view = render_gsplat(splat, camera(), method, screen=screen)
    assert screen.visible is not None
    assert screen.visible.sum() == 49
    assert screen.gradient is None
    loss = view.colour.sum()
    del view
    loss.backward()
    assert screen.gradient is not None
    assert screen.gradient.shape == (50,)


def test_missing_library_names_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(InputError, match=r'pip install "gaussian-enhancer\[cuda\]"'):
        render_gsplat(scene(ThreeDGS()), camera(), ThreeDGS())


def test_other_dtypes_are_refused(library: StandIn) -> None:
    with pytest.raises(InputError, match="float64"):
        render_gsplat(scene(ThreeDGS()).to(torch.float64), camera(), ThreeDGS())


@pytest.mark.cuda
@pytest.mark.skipif(importlib.util.find_spec("gsplat") is None, reason="gsplat is not installed")
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@by_name
def test_gsplat_agrees_with_the_oracle(method: Method) -> None:
    splat, background = scene(method, 300), (0.2, 0.5, 0.7)
    leaves = (splat.means, splat.log_scales, splat.quaternions, splat.opacity_logits, splat.sh)
    gradients = []
    views = []
    for dtype, device in ((torch.float32, "cuda"), (torch.float64, "cpu")):
        moved = [leaf.to(device, dtype).requires_grad_() for leaf in leaves]
        smoothing = None if splat.smoothing is None else splat.smoothing.to(device, dtype)
        draw = render_gsplat if device == "cuda" else render_oracle
        view = draw(Gaussians(*moved, smoothing), camera().to(device, dtype), method, background)
        weights = torch.randn(3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(1)).to(view.colour)
        gradients.append(torch.autograd.grad((view.colour * weights).sum() + view.alpha.sum(), moved))
        views.append(view)
    got, wanted = views
    tolerance = 2e-2 if isinstance(method, TwoDGS) else 2e-3
    assert (got.colour.cpu() - wanted.colour).abs().mean() < tolerance
    assert (got.alpha.cpu() - wanted.alpha).abs().mean() < tolerance
    solid = wanted.alpha > 0.5
    if not isinstance(method, TwoDGS):
        assert (got.depth.cpu() - wanted.depth)[solid].abs().mean() < 1e-2
    for a, b in zip(*gradients, strict=True):
        assert (a.cpu() - b).norm() < 0.1 * b.norm()
