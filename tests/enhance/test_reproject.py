import math

import pytest
import torch

from gaussian_enhancer.enhance import depth as depth_search
from gaussian_enhancer.enhance.colour import apply_colour, fit_colour
from gaussian_enhancer.enhance.depth import refine_depth
from gaussian_enhancer.enhance.reproject import fill_depth, reproject
from gaussian_enhancer.types import identity_camera
from textured_plane import REFERENCE, TARGET, plane, turned


def test_plane_is_reprojected_exactly():
    truth, depth = plane(TARGET, 3.0)
    photo, seen = plane(REFERENCE, 3.0)
    warped = reproject(TARGET, depth, REFERENCE, photo, seen, torch.ones_like(depth))
    inside = warped.visibility[0] > 0.5
    assert inside.double().mean() > 0.7
    error = (warped.colour - truth)[:, inside].abs()
    assert error.quantile(0.95) < 4e-3  # what bilinear reading costs; the rest lies on the photo's outermost half pixel
    assert error.max() < 0.06


def test_same_camera_returns_the_photo():
    photo, depth = plane(TARGET, 3.0)
    warped = reproject(TARGET, depth, TARGET, photo)
    torch.testing.assert_close(warped.colour, photo, rtol=0, atol=1e-9)
    assert bool((warped.visibility == 1).all())


def test_occluded_and_outside_are_invisible():
    photo, _ = plane(REFERENCE, 3.0)
    _, depth = plane(TARGET, 3.0)
    occluder = torch.full((1, 480, 640), 1.0, dtype=torch.float64)
    assert reproject(TARGET, depth, REFERENCE, photo, occluder).visibility.max() < 1e-6
    away = turned(REFERENCE, math.pi, (0.0, 0.0, 0.0))
    behind = reproject(TARGET, depth, away, photo)
    assert behind.visibility.max() == 0
    assert behind.colour.abs().max() == 0


def test_finer_reference_is_antialiased():
    _, depth = plane(TARGET, 3.0)
    fine = torch.zeros(3, 480, 640, dtype=torch.float64)
    fine[..., ::2] = 1
    colour = reproject(TARGET, depth, identity_camera(480, 640, 600.0, torch.float64), fine).colour
    assert (colour - 0.5).abs().max() < 0.06


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (33, 20)])
def test_holes_are_filled_from_neighbours(size):
    depth = torch.full((1, *size), 2.0)
    depth[..., 0, 0] = float("nan") if size != (1, 1) else 2.0
    depth[..., -1, -1] = 0.0 if size != (1, 1) else 2.0
    torch.testing.assert_close(fill_depth(depth), torch.full((1, *size), 2.0))
    assert bool((fill_depth(torch.zeros(1, *size)) == 1).all())


def test_holes_stay_invisible():
    photo, depth = plane(TARGET, 3.0)
    depth[..., 10:20, 10:20] = 0
    assert reproject(TARGET, depth, TARGET, photo).visibility[..., 10:20, 10:20].max() == 0


def test_wrong_depth_is_refined():
    render, truth = plane(TARGET, 3.0)
    cameras = [REFERENCE, turned(REFERENCE, -0.1, (-0.3, 0.1, 0.0))]
    photos = [plane(camera, 3.0)[0].float() for camera in cameras]
    wrong = (truth * 1.12).float()
    better = refine_depth(TARGET, wrong, render.float(), cameras, photos, "expected")
    error = (better.double() / truth).log().abs().flatten()
    assert error.median() < 0.25 * math.log(1.12)
    torch.testing.assert_close(refine_depth(TARGET, wrong, render.float(), [], [], "expected"), wrong)
    assert torch.equal(refine_depth(TARGET, wrong, render.float(), cameras, photos, "exact"), wrong)


def test_compiled_search_equals_its_readable_twin():
    render, truth = plane(TARGET, 3.0)
    camera = REFERENCE.resized(48, 64)
    photo = plane(camera, 3.0)[0].float() * 0.9
    z, image = (truth * 1.05).float(), render.float()
    z[..., :20, :30] = 0.05
    how = depth_search.Search(0.15, 9)
    seen = [depth_search._seen(TARGET, z, image, camera, photo)]
    compiled, plain = (f(z, image, seen, how) for f in (depth_search._search_compiled, depth_search.search))
    assert (compiled - plain).abs().median() < 1e-5
    assert ((compiled - plain).abs() > 1e-3).float().mean() < 0.01


def test_colour_transform_is_recovered_despite_outliers():
    generator = torch.Generator().manual_seed(0)
    target = torch.nn.functional.avg_pool2d(torch.rand(3, 260, 260, generator=generator), 5)
    target = ((target - target.mean()) * 3 + 0.5).clamp(0.04, 0.96)
    source = (target - 0.03) / 1.25
    source[:, :8] = 0.9
    transform = fit_colour(source, target, torch.ones(1, 52, 52), prior=0.0)
    torch.testing.assert_close(transform[:, 0], torch.full((3,), 1.25, dtype=torch.float64), rtol=0.02, atol=0)
    assert (apply_colour(source, transform) - target)[:, 12:].abs().max() < 0.02
    unseen = fit_colour(source, target, torch.zeros(1, 52, 52))
    torch.testing.assert_close(unseen, torch.tensor([[1.0, 0.0]], dtype=torch.float64).expand(3, 2))
