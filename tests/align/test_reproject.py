import math
from dataclasses import replace

import pytest
import torch

from gaussian_enhancer.align import depth_search as depth_search
from gaussian_enhancer.align.depth_search import Search, Source, refine_depth
from gaussian_enhancer.align.projection import ReferenceProjection, project_pixels
from gaussian_enhancer.align.reproject import fill_depth, reproject
from gaussian_enhancer.types import identity_camera
from support.textured_plane import REFERENCE, TARGET, plane, turned


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
    sources = [Source(*source) for source in zip(cameras, photos, strict=True)]
    better = refine_depth(TARGET, wrong, render.float(), sources, kind="expected")
    error = (better.double() / truth).log().abs().flatten()
    assert error.median() < 0.25 * math.log(1.12)
    torch.testing.assert_close(refine_depth(TARGET, wrong, render.float(), [], kind="expected"), wrong)
    assert torch.equal(refine_depth(TARGET, wrong, render.float(), sources, kind="exact"), wrong)


@pytest.mark.parametrize(
    "search",
    [Search(0.15, 9), Search(0.15, 9, stride=2, inconsistency=1.0, photo_consistency=0.3), Search(0.1, 5, 3, stride=3)],
    ids=["renders", "photos too", "every third"],
)
@pytest.mark.parametrize("views", [1, 3])
def test_compiled_search_equals_its_readable_twin(search, views):
    render, truth = plane(TARGET, 3.0)
    cameras = [REFERENCE.resized(48, 64), turned(REFERENCE, -0.1, (-0.3, 0.1, 0.0)), TARGET][:views]
    full = (truth * 1.05).float(), render.float()
    z, image = (one[..., :: search.stride, :: search.stride].contiguous() for one in full)
    z[..., :10, :12] = 0.05
    references = []
    for camera in cameras:
        rendered = plane(camera, 3.0)[0].float()
        photo = rendered * 0.9 + 0.05 * torch.rand(rendered.shape, generator=torch.Generator().manual_seed(1))
        references.append(depth_search._prepare_source(TARGET, z, image, Source(camera, photo, rendered), search))
    compiled = depth_search._search_compiled(z, image, references, search)
    readable = depth_search.search_torch(z, image, references, search)
    assert (compiled - readable).abs().median() < 1e-5
    assert ((compiled - readable).abs() > 1e-3).float().mean() < 0.01
    assert compiled.abs().max() > 0.2
    doubled = [_double(reference) for reference in references]
    exact = depth_search.search_torch(z.double(), image.double(), doubled, search)
    assert (readable - exact).abs().median() < 1e-5


def _double(reference):
    tensors = {name: getattr(reference, name).double() for name in ("photo", "render", "mask")}
    projection = replace(
        reference.projection, matrix=reference.projection.matrix.double(), offset=reference.projection.offset.double()
    )
    return replace(reference, projection=projection, **tensors)


def test_photos_place_what_the_splat_blurs():
    render, truth = plane(TARGET, 3.0)
    cameras = [REFERENCE, turned(REFERENCE, -0.1, (-0.3, 0.1, 0.0)), turned(REFERENCE, 0.1, (0.2, -0.2, 0.0))]
    photos = [plane(camera, 3.0)[0].float() for camera in cameras]
    flat = [torch.full_like(photo, 0.5) for photo in photos]
    wrong, image = (truth * 1.02).float(), torch.full_like(render, 0.5).float()

    def seen(shown):
        return [Source(*source) for source in zip(cameras, shown, flat, strict=True)]

    def error(consistent):
        found = refine_depth(TARGET, wrong, image, seen(photos), consistent=consistent)
        return (found.double() / truth).log().abs().median()

    assert error(consistent=True) < 0.25 * math.log(1.02) < error(consistent=False)
    same = refine_depth(TARGET, wrong, image, seen(flat))
    torch.testing.assert_close(same, wrong, rtol=1e-4, atol=0)


@pytest.mark.parametrize("side", [(7, 9), (8, 10), (1, 1), (2, 1)])
def test_a_change_is_linear_between_samples(side):
    height, width = side
    plain = torch.arange(height)[None, :, None] * 0.5 + torch.arange(width)[None, None] * 0.25
    samples = plain[..., ::2, ::2]
    spread = depth_search._interpolate_change(samples, 2, height, width)
    assert spread.shape == plain.shape
    assert torch.equal(spread[..., ::2, ::2], samples)
    inner = (slice(None), slice(0, height - 1 + height % 2), slice(0, width - 1 + width % 2))
    torch.testing.assert_close(spread[inner], plain[inner])


def test_every_second_pixel_lands_where_it_did():
    projection = ReferenceProjection.between(TARGET, REFERENCE, torch.zeros(1, dtype=torch.float64))
    depth = torch.rand(1, 33, 47, generator=torch.Generator().manual_seed(0), dtype=torch.float64) + 2
    every, second = project_pixels(projection, depth), project_pixels(projection.with_stride(2), depth[..., ::2, ::2])
    torch.testing.assert_close(second.x, every.x[..., ::2, ::2])
    torch.testing.assert_close(second.y, every.y[..., ::2, ::2])


def test_cubic_reading_keeps_more_of_fine_detail_than_linear():
    ramp = torch.arange(64, dtype=torch.float64)
    errors = []
    camera = identity_camera(64, 64, 60.0, torch.float64)
    moved = turned(camera, 0.0, (0.025, 0.0, 0.0))  # half a pixel at depth 3
    depth = torch.full((1, 64, 64), 3.0, dtype=torch.float64)

    def wave(shift: float) -> torch.Tensor:
        return (0.5 + 0.4 * torch.sin((ramp + shift) * 2 * math.pi / 5)).expand(3, 64, 64).contiguous()

    for interpolation in ("bilinear", "bicubic"):
        warped = reproject(camera, depth, moved, wave(0.5), interpolation=interpolation)
        errors.append(float((warped.colour - wave(0.0))[..., 4:-4].square().mean()))
    assert errors[1] < 0.3 * errors[0]


def test_compiled_cubic_reading_equals_its_readable_twin():
    generator = torch.Generator().manual_seed(0)
    photo, depth = torch.rand(3, 30, 41, generator=generator), torch.full((1, 24, 37), 2.0)
    cameras = identity_camera(24, 37, 30.0), turned(identity_camera(30, 41, 33.0), 0.05, (0.1, 0.02, 0.0))
    target, reference = (replace(c, K=c.K.float(), world_to_camera=c.world_to_camera.float()) for c in cameras)
    found = reproject(target, depth, reference, photo, interpolation="bicubic")
    truth = reproject(target, depth.double(), reference, photo.double(), interpolation="bicubic")
    inside = (found.visibility > 0)[0] & (truth.visibility > 0)[0]
    assert inside.float().mean() > 0.7
    torch.testing.assert_close(found.colour[:, inside].double(), truth.colour[:, inside], rtol=0, atol=2e-4)
    assert 0 <= float(found.colour.min()) <= float(found.colour.max()) <= 1
