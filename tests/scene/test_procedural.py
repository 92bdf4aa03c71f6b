"""Properties of procedural scenes: determined, exact, consistent over sizes and views, rich in detail."""

import dataclasses
import pickle

import pytest
import torch
from torch.nn import functional

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.procedural import FAMILIES, procedural_scene
from gaussian_enhancer.scene.procedural.source import _bake_cached
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.scene.splits import Split

SIZE = {"height": 96, "width": 128}


@pytest.fixture(scope="module", params=[("object", 3), ("indoor", 3)], ids=lambda p: p[0])
def scene(request: pytest.FixtureRequest) -> Scene:
    family, seed = request.param
    return procedural_scene(family, seed, **SIZE, points=500)


def resized(photo: Photo, factor: int) -> Photo:
    view = photo.read.__self__  # type: ignore[attr-defined]
    camera = view.camera.resized(view.camera.height * factor, view.camera.width * factor)
    view = dataclasses.replace(view, camera=camera)
    return Photo(photo.name, camera, view.photo, view.depth, view.alpha)


def test_names_splits_and_ranges(scene: Scene) -> None:
    assert [p.name for p in scene.photos[:2]] == ["0000.png", "0001.png"]
    assert scene.test == tuple(range(0, 48, 8))
    assert sorted(scene.train + scene.test) == list(range(48))
    image, depth = scene.photos[3].read(), scene.photos[3].read_depth()
    assert image.shape == (3, 96, 128)
    assert depth.shape == (1, 96, 128)
    assert image.min() >= 0
    assert image.max() <= 1
    assert image.std() > 0.08
    assert torch.isfinite(depth).all()
    assert (depth[depth > 0] > 0.02).all()


def test_a_view_survives_pickling_and_gives_the_same_picture(scene: Scene) -> None:
    again = pickle.loads(pickle.dumps(scene.photos[5].read))
    assert torch.equal(again(), scene.photos[5].read())


def test_larger_photo_downsampled_is_the_smaller_one(scene: Scene) -> None:
    small = scene.photos[6].read()
    large = resized(scene.photos[6], 4).read()
    difference = (functional.avg_pool2d(large[None], 4)[0] - small).abs()
    assert difference.mean() < 0.02
    # Shifted by one small pixel the agreement must be lost, or the picture is too smooth to tell.
    assert (functional.avg_pool2d(large[None], 4)[0].roll(1, 2) - small).abs().mean() > 2 * difference.mean()


def test_depth_lies_on_the_same_pixel_centres_at_any_size(scene: Scene) -> None:
    small = scene.photos[6].read_depth()
    large = resized(scene.photos[6], 3).read_depth()[:, 1::3, 1::3]
    agree = (small - large).abs() <= 1e-4 * small
    assert agree.float().mean() > 0.999


def test_depth_agrees_between_views(scene: Scene) -> None:
    first, second = scene.photos[8], resized(scene.photos[9 if scene.name.startswith("indoor") else 16], 4)
    z = first.read_depth()[0]
    v, u = torch.meshgrid(torch.arange(96) + 0.5, torch.arange(128) + 0.5, indexing="ij")
    rays = torch.stack([u, v, torch.ones_like(u)], -1).view(-1, 3) @ torch.linalg.inv(first.camera.K).T
    seen = (z > 0).flatten()
    world = (rays * z.flatten()[:, None] - first.camera.world_to_camera[:3, 3]) @ first.camera.rotation
    local = world[seen] @ second.camera.rotation.T + second.camera.world_to_camera[:3, 3]
    pixel = local @ second.camera.K.T
    xy = pixel[:, :2] / pixel[:, 2:]
    size = torch.tensor([second.camera.width, second.camera.height])
    inside = (local[:, 2] > 0.05) & (xy > 1).all(1) & (xy < size - 1).all(1)
    x, y = xy[inside].long().unbind(1)
    other, expected = second.read_depth()[0][y, x], local[inside, 2]
    # Within a pixel of slanted surface the same, or hidden by something nearer; never seen through.
    same = (other - expected).abs() < 0.02 * expected
    behind = (other == 0) | (other > expected * 1.02)
    assert inside.float().mean() > 0.2
    assert same.float().mean() > 0.6
    assert behind.float().mean() < 0.04


def test_points_lie_on_surfaces(scene: Scene) -> None:
    assert scene.points is not None
    assert scene.points.positions.shape == (500, 3)
    world = _bake_cached(*scene.name.split("_")[:1], int(scene.name.split("_")[1]), "cpu")[0]
    corners = world.mesh.corners
    low, high = corners.amin((0, 1)), corners.amax((0, 1))
    assert ((scene.points.positions > low - 0.5) & (scene.points.positions < high + 0.5)).all()
    distance = torch.cdist(scene.points.positions, corners.mean(1)).amin(1)
    assert distance.median() < 0.3


def test_spectrum_is_that_of_a_photo(scene: Scene) -> None:
    grey = scene.photos[4].read().mean(0)
    window = torch.hann_window(96)[:, None] * torch.hann_window(128)[None]
    power = torch.fft.rfft2((grey - grey.mean()) * window).abs() ** 2
    frequency = torch.hypot(torch.fft.fftfreq(96)[:, None], torch.fft.rfftfreq(128)[None])
    share = float(power[frequency > 0.125].sum() / power[frequency > 0].sum())
    # White noise has about 0.95, a picture blurred to a quarter of its size below 0.005.
    assert 0.01 < share < 0.35
    logs = [power[(frequency > low) & (frequency < 2 * low)].mean().log2() for low in (0.03, 0.06, 0.12, 0.24)]
    slope = float(logs[-1] - logs[0]) / 3
    assert -4.0 < slope < -0.8


def test_object_has_exact_coverage_over_white() -> None:
    scene = procedural_scene("object", 3, **SIZE, points=0)
    photo = scene.photos[2]
    assert scene.background == (1.0, 1.0, 1.0)
    alpha, image, depth = photo.read_alpha(), photo.read(), photo.read_depth()
    assert (image[:, alpha[0] == 0] == 1).all()
    # A gap narrower than the samples' spacing may lie at the centre of a covered pixel, or the other way round.
    assert (depth[alpha == 1] > 0).float().mean() > 0.998
    assert (depth[alpha == 0] == 0).float().mean() > 0.998
    fine = functional.avg_pool2d(resized(photo, 4).read_alpha()[None], 4)[0]
    assert (fine - alpha).abs().mean() < 0.015
    assert 0.1 < alpha.mean() < 0.8


def test_same_seed_same_scene_and_other_seed_another() -> None:
    first = procedural_scene("object", 3, **SIZE, points=200)
    image = first.photos[1].read()
    _bake_cached.cache_clear()
    again = procedural_scene("object", 3, **SIZE, points=200)
    assert torch.equal(image, again.photos[1].read())
    assert torch.equal(first.points.positions, again.points.positions)
    other = procedural_scene("object", 2, **SIZE, points=0)
    assert (image - other.photos[1].read()).abs().mean() > 0.03


def test_thinning_leaves_views_out_or_tests_on_them() -> None:
    sparse = procedural_scene("object", 3, **SIZE, split=Split(train_every=4), points=0)
    pairs = procedural_scene("object", 3, **SIZE, split=Split(train_every=4, unused_as_test=True), points=0)
    assert sparse.train == pairs.train
    assert set(sparse.test) < set(pairs.test)
    assert len(pairs.train) + len(pairs.test) == 48
    assert len(sparse.train) == 11


def test_wrong_input_is_refused_by_name() -> None:
    with pytest.raises(InputError) as caught:
        procedural_scene("forest", 0)
    assert all(name in str(caught.value) for name in FAMILIES)
    with pytest.raises(InputError, match="seed"):
        procedural_scene("object", -1)


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_fills_its_views(family: str) -> None:
    scene = procedural_scene(family, 1001, height=48, width=64, points=100)
    for photo in scene.photos[::12]:
        image, depth = photo.read(), photo.read_depth()
        assert image.std() > 0.05
        assert (depth > 0).float().mean() > (0.1 if family == "object" else 0.5)
        assert float(depth[depth > 0].median()) > 0.5


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_the_gpu_gives_the_same_picture() -> None:
    slow = procedural_scene("object", 3, **SIZE, points=0).photos[1]
    fast = procedural_scene("object", 3, **SIZE, points=0, device="cuda").photos[1]
    assert (slow.read() - fast.read()).abs().mean() < 2e-3
    assert ((slow.read_depth() - fast.read_depth()).abs() < 1e-3).float().mean() > 0.999
