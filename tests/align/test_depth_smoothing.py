import pytest
import torch

from gaussian_enhancer.align import depth_search
from gaussian_enhancer.align.depth_search import SEARCHES, Source, refine_depth
from gaussian_enhancer.align.depth_smoothing import WINDOW_RADIUS, fit_planes_torch, smooth_depth
from gaussian_enhancer.types import identity_camera


def ramp(height: int = 40, width: int = 48, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    """A slanted plane: linear in inverse depth."""
    rows, columns = torch.arange(height, dtype=dtype)[:, None], torch.arange(width, dtype=dtype)
    return 1 / (0.25 + 2e-3 * rows - 1e-3 * columns)[None]


def noise(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def grey(depth: torch.Tensor) -> torch.Tensor:
    return torch.full((3, *depth.shape[1:]), 0.5, dtype=depth.dtype)


def test_a_plane_stays_where_it_is():
    inner = (..., slice(12, -12), slice(12, -12))  # beyond the border the plane is continued by its last pixel
    torch.testing.assert_close(smooth_depth(ramp(), grey(ramp()))[inner], ramp()[inner], rtol=1e-12, atol=0)


def test_noise_on_a_plane_falls_to_a_third():
    noisy = ramp() * (1 + 0.005 * noise(1, 40, 48))
    left = (smooth_depth(noisy, grey(noisy)) / ramp() - 1)[..., 12:-12, 12:-12].std()
    assert left < 0.005 / 3


def test_edges_of_depth_and_of_colour_stay():
    step = torch.full((1, 32, 32), 2.0, dtype=torch.float64)
    step[..., 16:] = 2.5
    torch.testing.assert_close(smooth_depth(step, grey(step)), step, rtol=1e-3, atol=0)
    small = step.clone()
    small[..., 16:] = 2.02  # too little to be told by depth
    coloured = grey(step)
    coloured[..., 16:] = 1.0
    plain, told = ((smooth_depth(small, image) - small).abs().max() for image in (grey(step), coloured))
    assert told < plain / 2


@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e6])
def test_scene_units_cancel(unit):
    noisy, image = ramp() * (1 + 0.02 * noise(1, 40, 48)), noise(3, 40, 48).abs()
    torch.testing.assert_close(smooth_depth(unit * noisy, image), unit * smooth_depth(noisy, image), rtol=1e-9, atol=0)


def test_the_kernel_agrees_with_its_twin():
    depth = (ramp() * (1 + 0.02 * noise(1, 40, 48)) * torch.where(noise(1, 40, 48) > 1.5, 3.0, 1.0)).float()
    image = noise(3, 40, 48).abs().clamp_max(1).float()
    torch.testing.assert_close(
        smooth_depth(depth, image), smooth_depth(depth.double(), image.double()).float(), rtol=2e-6, atol=0
    )


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_any_depth_stays_finite_and_positive(dtype):
    extreme = 10.0 ** torch.randint(-18, 18, (1, 17, 23), generator=torch.Generator().manual_seed(0)).to(dtype)
    found = smooth_depth(extreme, grey(extreme))
    assert bool(torch.isfinite(found).all())
    assert bool((found > 0).all())
    single = torch.tensor([[[3.0]]], dtype=dtype)
    torch.testing.assert_close(smooth_depth(single, grey(single)), single)


def test_a_pixel_on_its_own_keeps_its_depth():
    spike = torch.full((1, 9, 9), 1.0, dtype=torch.float64)
    spike[0, 4, 4] = 30.0
    change = fit_planes_torch(
        torch.nn.functional.pad(spike[None], (WINDOW_RADIUS,) * 4, mode="replicate")[0], torch.ones(3, 13, 13), 1
    )
    assert change[0, 4, 4].abs() < 1e-3


def test_exact_depth_is_not_smoothed_and_holes_stay_holes():
    depth = (ramp() * (1 + 0.005 * noise(1, 40, 48))).float()
    depth[..., 3:5, 3:5] = 0
    image, camera = grey(depth), identity_camera(40, 48, 40.0)
    for kind in ("surface", "expected"):
        smoothed = refine_depth(camera, depth, image, [], kind=kind)
        assert bool((smoothed[depth == 0] == 0).all())
        assert not torch.equal(smoothed, depth)
        assert torch.equal(refine_depth(camera, depth, image, [], kind=kind, smooth=False), depth)
    assert torch.equal(refine_depth(camera, depth, image, [], kind="exact"), depth)


def test_expected_depth_is_smoothed_before_each_of_its_searches(monkeypatch):
    calls = []
    monkeypatch.setattr(depth_search, "smooth_depth", lambda depth, _: calls.append(depth) or depth)
    depth, camera = ramp().float(), identity_camera(40, 48, 40.0)
    image = grey(depth)
    refine_depth(camera, depth, image, [Source(camera, image, image)], kind="expected")
    assert len(calls) == len(SEARCHES["expected"])
