"""Distilling on the run of a textured plane whose splat is a sheet of Gaussians: rounds, resuming, what may be seen."""

import dataclasses
from collections.abc import Callable

import pytest
import torch

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.distil import distil as module
from gaussian_enhancer.distil.distil import distil
from gaussian_enhancer.distil.enhanced_views import EnhancedViews
from gaussian_enhancer.distil.new_cameras import new_cameras
from gaussian_enhancer.distil.settings import DistilSettings
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.runs.rendered_capture import SplatRenderer
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.splat.filters import filter_size
from gaussian_enhancer.splat.methods import MipSplatting, ThreeDGS, TwoDGS
from support.bright_weights import bright_network
from support.synthetic_runs import coloured_sheet, plane_camera, plane_view

SIZE = 48, 64
QUICK = DistilSettings(steps=12, rounds=2, views=4, share=0.5)


def unreadable() -> torch.Tensor:
    raise AssertionError("a held-out photo was read")


def capture_of(held_out: Callable[[], torch.Tensor] = unreadable, shift: float = 0.0) -> Scene:
    """Eight photos of a plane, every fourth held out."""
    texture = torch.rand(3, 48, 48, generator=torch.Generator().manual_seed(0))
    photos = []
    for index in range(8):
        camera = plane_camera(index, *SIZE)
        pixels = plane_view(camera, texture)[0]
        if index % 4 == 0:
            pose = camera.world_to_camera.clone()
            pose[0, 3] += shift
            photos.append(Photo(f"{index}.png", dataclasses.replace(camera, world_to_camera=pose), held_out))
        else:
            photos.append(Photo(f"{index}.png", camera, lambda pixels=pixels: pixels))
    train = tuple(index for index in range(8) if index % 4)
    return Scene("plane", tuple(photos), train, (0, 4))


def sheet(method=None) -> SplatRenderer:
    gaussians, method = coloured_sheet(24), method or ThreeDGS()
    if isinstance(method, TwoDGS):
        gaussians = dataclasses.replace(gaussians, log_scales=gaussians.log_scales[:, :2])
    if isinstance(method, MipSplatting):
        cameras = [plane_camera(index, *SIZE) for index in range(8) if index % 4]
        gaussians = dataclasses.replace(gaussians, smoothing=filter_size(gaussians.means, cameras))
    return SplatRenderer(gaussians, method, (0.0, 0.0, 0.0), 0.01)


@pytest.fixture(scope="module")
def enhancer() -> SetEnhancer:
    """A network that brightens what it sees."""
    return SetEnhancer(bright_network(), ReferenceConfig(), precision="float32", pass_through=True)


def equal(first, second) -> bool:
    pairs = [(getattr(first, f.name), getattr(second, f.name)) for f in dataclasses.fields(first)]
    return all(a is b if a is None else torch.equal(a, b) for a, b in pairs)


def test_neither_photo_nor_camera_of_a_held_out_view_is_used(enhancer, tmp_path):
    one = distil(capture_of(), sheet(), enhancer, tmp_path / "one", QUICK, progress=False)
    other = distil(capture_of(shift=0.7), sheet(), enhancer, tmp_path / "other", QUICK, progress=False)
    bare = capture_of().with_split(capture_of().train, ())
    without = distil(bare, sheet(), enhancer, tmp_path / "bare", QUICK, progress=False)
    assert equal(one, other)
    assert equal(one, without)


@pytest.mark.parametrize("stop", [3, 6, 8])
def test_a_resumed_run_equals_the_uninterrupted_one(enhancer, tmp_path, monkeypatch, stop):
    start, capture = sheet(MipSplatting()), capture_of()
    whole = distil(capture, start, enhancer, tmp_path / "whole", QUICK, progress=False)
    distil(capture, start, enhancer, tmp_path / "parts", QUICK, progress=False, stop_after=stop)
    made = []
    make = EnhancedViews.make
    monkeypatch.setattr(EnhancedViews, "make", lambda *words: (made.append(i) or i for i in make(*words)))
    parts = distil(capture, start, enhancer, tmp_path / "parts", QUICK, progress=False)
    assert equal(whole, parts)
    assert len(made) == (4 if stop < 7 else 0)  # the second round begins with step 6, its views before it
    for path in (tmp_path / "whole/rounds").rglob("*.png"):
        assert (
            path.read_bytes() == (tmp_path / "parts/rounds" / path.relative_to(tmp_path / "whole/rounds")).read_bytes()
        )


def test_a_run_that_was_killed_between_two_views_makes_only_those_that_lack(enhancer, tmp_path, monkeypatch):
    start, capture = sheet(), capture_of()
    whole = distil(capture, start, enhancer, tmp_path / "whole", QUICK, progress=False)
    make = EnhancedViews.make

    def killed(*words):
        for index in make(*words):
            if index == 1:
                raise KeyboardInterrupt
            yield index

    monkeypatch.setattr(EnhancedViews, "make", killed)
    with pytest.raises(KeyboardInterrupt):
        distil(capture, start, enhancer, tmp_path / "parts", QUICK, progress=False)
    assert len(list((tmp_path / "parts/rounds/1").glob("*.png"))) == 2
    made = []
    monkeypatch.setattr(EnhancedViews, "make", lambda *words: (made.append(i) or i for i in make(*words)))
    assert equal(whole, distil(capture, start, enhancer, tmp_path / "parts", QUICK, progress=False))
    assert made == [2, 3, 0, 1, 2, 3]


def test_a_new_run_where_a_checkpoint_was_deleted_makes_its_own_views(enhancer, tmp_path):
    start, capture = sheet(), capture_of()
    whole = distil(capture, start, enhancer, tmp_path / "whole", QUICK, progress=False)
    other = dataclasses.replace(QUICK, seed=QUICK.seed + 1)
    distil(capture, start, enhancer, tmp_path / "parts", other, progress=False, stop_after=2)
    (tmp_path / "parts/checkpoint.pt").unlink()
    assert equal(whole, distil(capture, start, enhancer, tmp_path / "parts", QUICK, progress=False))


@pytest.mark.parametrize("method", [ThreeDGS(), TwoDGS(), MipSplatting()], ids=lambda m: m.name)
def test_each_kind_learns_from_photos_and_stays_of_its_kind(tmp_path, method):
    capture, start = capture_of(), sheet(method)
    settings = DistilSettings(steps=60, share=0.0)
    found = distil(capture, start, None, tmp_path, settings, progress=False)
    errors = []
    for gaussians in (start.gaussians, found):
        drawn = dataclasses.replace(start, gaussians=gaussians)
        errors.append(sum(float((drawn(p.camera).colour - p.read()).square().mean()) for p in capture.train_photos))
    assert errors[1] < 0.9 * errors[0]
    for field in dataclasses.fields(found):
        before, after = (getattr(one, field.name) for one in (start.gaussians, found))
        assert (before is None) == (after is None)
        assert before is None or before.shape == after.shape
    assert not (tmp_path / "rounds").exists()


def test_enhanced_views_pull_the_splat_as_far_as_they_are_trusted(enhancer, tmp_path, monkeypatch):
    moved = {}
    for trust in (0.0, 1.0):
        monkeypatch.setattr(
            EnhancedViews, "read", lambda *_, trust=trust: (torch.ones(3, *SIZE), torch.full((1, *SIZE), trust))
        )
        settings = dataclasses.replace(QUICK, share=1.0)
        folder = tmp_path / str(trust)
        moved[trust] = distil(capture_of(), sheet(), enhancer, folder, settings, progress=False)
    assert equal(moved[0.0], sheet().gaussians)
    assert float((moved[1.0].sh - sheet().gaussians.sh).mean()) > 0.005


def test_a_view_is_trusted_where_photos_see_it(enhancer, tmp_path):
    camera = plane_camera(5, *SIZE)
    pose = camera.world_to_camera.clone()
    pose[0, 3] -= 1.2  # its right part lies beyond every photo
    views = EnhancedViews(tmp_path, (dataclasses.replace(camera, world_to_camera=pose),))
    assert list(views.make(sheet(), capture_of().train_photos[:2], enhancer)) == [0]
    image, trust = views.read(0)
    assert image.shape == (3, *SIZE)
    assert float(trust[..., :8].mean()) > 0.5
    assert float(trust[..., -8:].max()) == 0
    assert list(views.make(sheet(), capture_of().train_photos[:2], enhancer)) == []


def test_new_cameras_lie_between_and_around_the_training_cameras():
    cameras = [plane_camera(index, *SIZE) for index in range(8)]
    way = new_cameras(cameras, 6, 0.0, rounds=2)
    aside = new_cameras(cameras, 6, 0.5, rounds=2, seed=3)
    unit = 0.12 * 1.01
    for plain, moved in zip(way, aside, strict=True):
        assert torch.equal(plain.rotation, moved.rotation)
        assert 0 < float((plain.centre - moved.centre).norm()) <= 0.5 * 3**0.5 * 1.3 * unit
    centres = torch.stack([camera.centre for camera in (*way, *new_cameras(cameras, 6, 0.0, round_index=1, rounds=2))])
    assert float(torch.pdist(centres).min()) > 0.01  # no place twice
    again = new_cameras(cameras, 6, 0.5, rounds=2, seed=3)
    assert all(torch.equal(a.world_to_camera, b.world_to_camera) for a, b in zip(aside, again, strict=True))


def test_new_cameras_of_a_capture_far_from_the_origin_are_moved_aside_as_far():
    moved = []
    for offset in (torch.zeros(3), torch.tensor([500.0, 300.0, 100.0])):
        cameras = [plane_camera(index, *SIZE) for index in range(30)]
        for camera in cameras:
            camera.world_to_camera[:3, 3] -= camera.rotation @ offset
        path, aside = (new_cameras(cameras, 6, displacement) for displacement in (0.0, 0.5))
        moved.append([float((a.centre - b.centre).norm()) for a, b in zip(path, aside, strict=True)])
    assert moved[1] == pytest.approx(moved[0], abs=1e-3)
    assert min(moved[1]) > 0.01


def test_a_checkpoint_of_other_settings_is_refused(enhancer, tmp_path):
    distil(capture_of(), sheet(), enhancer, tmp_path, QUICK, progress=False, stop_after=2)
    with pytest.raises(InputError, match="other settings"):
        distil(capture_of(), sheet(), enhancer, tmp_path, dataclasses.replace(QUICK, weight=0.1), progress=False)


def test_settings_out_of_range_are_refused():
    for bad in ({"steps": 0}, {"rounds": 0}, {"views": 1}, {"share": 1.5}, {"weight": -1.0}, {"fade": 0.0}):
        with pytest.raises(InputError, match=rf"settings\.{next(iter(bad))}"):
            DistilSettings(**bad)
    with pytest.raises(InputError, match="at most one a step"):
        DistilSettings(steps=2, rounds=3)
    settings = DistilSettings(steps=7, rounds=3)
    assert [settings.round_of(step) for step in range(7)] == [0, 0, 0, 1, 1, 2, 2]


def test_the_loop_saves_from_time_to_time(enhancer, tmp_path, monkeypatch):
    saved = []
    save = module.save_checkpoint
    monkeypatch.setattr(
        module, "save_checkpoint", lambda folder, values: (saved.append(values["step"]), save(folder, values))
    )
    distil(capture_of(), sheet(), enhancer, tmp_path, QUICK, progress=False, checkpoint_seconds=0.0)
    assert saved == [0, *range(1, 7), 6, *range(7, 13), 12]
