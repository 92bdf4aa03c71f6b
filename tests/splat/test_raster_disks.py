"""The compiled disk kernels against the oracle: values, gradients, and what must not matter."""

import dataclasses
import math

import pytest
import torch
from torch import Tensor

from gaussian_enhancer.splat.methods import TwoDGS
from gaussian_enhancer.splat.oracle import render_oracle
from gaussian_enhancer.splat.render import ScreenStatistics
from gaussian_enhancer.splat.render_disks import render_disks
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
    """Render in a dtype and pull fixed cotangents back; those of depth and normals only where alpha is far from its cut."""
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
