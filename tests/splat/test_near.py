"""The near plane follows scenes of extraordinary units, and no others."""

import dataclasses

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.methods import ThreeDGS, TwoDGS
from gaussian_enhancer.splat.near import near_plane
from gaussian_enhancer.splat.oracle import render_oracle
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.types import Camera, Gaussians, identity_camera


def camera(right: float, unit: float = 1.0) -> Camera:
    one = identity_camera(24, 32, 30.0)
    pose = torch.eye(4)
    pose[0, 3] = -right * unit
    return dataclasses.replace(one, world_to_camera=pose)


def gaussians(unit: float = 1.0, axes: int = 3, dtype: torch.dtype = torch.float32) -> Gaussians:
    draw = torch.Generator().manual_seed(0)
    means = (torch.rand(20, 3, generator=draw) - 0.5) * 2 + torch.tensor([0.0, 0.0, 4.0])
    logs = (0.2 * torch.rand(20, axes, generator=draw) + 0.05).log()
    rest = torch.randn(20, 4, generator=draw), torch.randn(20, generator=draw), torch.randn(20, 1, 3, generator=draw)
    scale = torch.tensor(unit)
    return Gaussians(means * scale, logs + scale.log(), *rest).to(dtype)


@pytest.mark.parametrize("extent", [0.05, 1.0, 300.0])
def test_ordinary_scenes_keep_the_plane_of_3dgs(extent):
    assert near_plane([camera(-extent), camera(extent)]) == 0.01


@pytest.mark.parametrize("unit", [1e-4, 1e6])
def test_other_scenes_are_cut_off_where_the_same_scene_in_ordinary_units_is(unit):
    cameras = [camera(side * 4 / 1.1, unit) for side in (-1, 1)]
    assert near_plane(cameras) == pytest.approx(0.01 * unit, rel=1e-3)
    assert near_plane([]) == near_plane(cameras[:1]) == 0.01


@pytest.mark.parametrize("unit", [1e-4, 1e6])
@pytest.mark.parametrize("axes", [2, 3])
def test_a_splat_looks_the_same_in_every_unit(unit, axes):
    method = ThreeDGS() if axes == 3 else TwoDGS()
    usual, scaled = (
        render(gaussians(u, axes), camera(0.3, u), method, near=near_plane([camera(-3, u), camera(3, u)]))
        for u in (1.0, unit)
    )
    assert float(usual.alpha.mean()) > 0.02
    torch.testing.assert_close(scaled.colour, usual.colour, atol=1e-3, rtol=0)
    torch.testing.assert_close(scaled.depth / unit, usual.depth, atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
@pytest.mark.parametrize("axes", [2, 3])
def test_half_precision_is_drawn_in_single(dtype, axes):
    """Case ordinary_3dgs: it was an error about types of matrices."""
    method = ThreeDGS() if axes == 3 else TwoDGS()
    half = gaussians(axes=axes, dtype=dtype)
    half.means.requires_grad_()
    image = render(half, camera(0.0), method)
    assert image.colour.dtype == torch.float32
    expected = render(half.to(torch.float32), camera(0.0), method)
    assert torch.equal(image.colour, expected.colour)
    image.colour.sum().backward()
    assert half.means.grad is not None
    assert half.means.grad.dtype == dtype
    assert half.means.grad.abs().sum() > 0


def test_a_gradient_that_half_precision_cannot_hold_is_refused():
    """Case focal_1e5_3dgs: it was infinite."""
    half = gaussians(axes=3, dtype=torch.float16)
    half.means.requires_grad_()
    image = render(half, camera(0.0), ThreeDGS())
    with pytest.raises(InputError, match="splat's means: is larger than"):
        (1e9 * image.colour.sum()).backward()


@pytest.mark.parametrize("axes", [2, 3])
def test_the_twin_leaves_out_what_is_not_finite_as_the_kernels_do(axes):
    """Case not_finite: the float64 reference itself was NaN."""
    method = ThreeDGS() if axes == 3 else TwoDGS()
    good = gaussians(axes=axes, dtype=torch.float64)
    means, logs = good.means.clone(), good.log_scales.clone()
    means[3, 1], logs[5, 0] = torch.nan, torch.inf
    bad = dataclasses.replace(good, means=means.requires_grad_(), log_scales=logs)
    eye = Camera(camera(0).K.double(), camera(0).world_to_camera.double(), 24, 32)
    image = render_oracle(bad, eye, method)
    rest = torch.tensor([i for i in range(20) if i not in (3, 5)])
    torch.testing.assert_close(image.colour, render_oracle(good[rest], eye, method).colour)
    image.colour.sum().backward()
    assert means.grad is not None
    assert means.grad.isfinite().all()
    kernels = render(bad.to(torch.float32), camera(0), method)
    torch.testing.assert_close(kernels.colour.double(), image.colour, atol=1e-3, rtol=0)
