import dataclasses
import hashlib
import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import torch

from gaussian_enhancer.align.alignment import Unwarped
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool, build_network_input, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import reference_config_of
from gaussian_enhancer.scene.high_resolution import attach_fine_photos
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.train.augment import Augmentation
from gaussian_enhancer.train.crops import Collate, Crops
from gaussian_enhancer.train.data import RunsData
from gaussian_enhancer.train.run_samples import RunSamples
from gaussian_enhancer.train.samples import FIXED_PLANES, PLANES_PER_REFERENCE, make_batch, prepare_samples
from support.synthetic_runs import write_plane_run


def test_a_sample_is_what_the_enhancer_sees(plane_run, tmp_path):
    rendered, reference_config = read_run(plane_run), ReferenceConfig()
    samples = prepare_samples(rendered, reference_config, tmp_path, "a")
    batch = make_batch([samples[0].planes()], samples[:1], reference_config.references)
    view = rendered.targets[0]
    target = read_target(view)
    seen = build_network_input(target, reference_config.align(target, view, ReferencePool(rendered.references)))
    assert view.read_photo is not None
    torch.testing.assert_close(batch.photo[0], view.read_photo())
    torch.testing.assert_close(batch.views.render, seen.render)
    torch.testing.assert_close(batch.views.references, seen.references, rtol=0, atol=0.5 / 255 + 1e-6)
    torch.testing.assert_close(batch.views.visibility, seen.visibility, rtol=0, atol=0.5 / 255 + 1e-6)
    assert seen.depth is not None
    assert seen.depth_unit is not None
    assert batch.views.depth is not None
    torch.testing.assert_close(batch.views.depth, seen.depth / seen.depth_unit, rtol=1e-3, atol=0)


def test_samples_are_prepared_once_for_each_preparation(plane_run, tmp_path):
    rendered, done = read_run(plane_run), []
    first = prepare_samples(rendered, ReferenceConfig(), tmp_path, "a", progress=lambda: done.append(1))
    again = prepare_samples(rendered, ReferenceConfig(), tmp_path, "a", progress=lambda: done.append(1))
    assert first == again
    assert len(done) == len(rendered.targets)
    other = prepare_samples(rendered, ReferenceConfig(Unwarped(), 2, 2), tmp_path, "a")
    assert other[0].path != first[0].path
    assert prepare_samples(rendered, ReferenceConfig(), tmp_path, "b")[0].path != first[0].path


def test_prepared_samples_may_be_moved(plane_run, tmp_path, monkeypatch):
    """The cache is named relative to the working folder, and read from another one after a move."""
    monkeypatch.chdir(tmp_path)
    first = prepare_samples(read_run(plane_run), ReferenceConfig(), Path("samples"), "a")
    (tmp_path / "samples").rename(tmp_path / "moved")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    again = prepare_samples(read_run(plane_run), ReferenceConfig(), Path("../moved"), "a")
    assert (again[0].planes() == np.load(tmp_path / "moved" / Path(*Path(first[0].path).parts[1:]))).all()


def test_photos_are_brought_to_the_exposure_of_their_render_where_asked(plane_run, tmp_path):
    rendered = read_run(plane_run)
    darker = [dataclasses.replace(view, read_photo=lambda view=view: 0.8 * view.read()) for view in rendered.targets]
    rendered = dataclasses.replace(rendered, targets=tuple(darker))
    plain = prepare_samples(rendered, ReferenceConfig(references=0), tmp_path, "a")
    matched = prepare_samples(rendered, ReferenceConfig(references=0), tmp_path, "a", match_exposure=True)
    assert plain[0].path != matched[0].path
    for samples, error in ((plain, 0.8), (matched, 1.0)):
        batch = make_batch([samples[0].planes()], samples[:1], references=0)
        seen = batch.views.render > 0.2
        assert float((batch.photo / batch.views.render)[seen].mean()) == pytest.approx(error, abs=0.02)


def test_of_two_trainings_that_begin_together_one_prepares(plane_run, tmp_path):
    rendered, done = read_run(plane_run), []
    with ThreadPoolExecutor(2) as executor:
        both = [
            executor.submit(
                prepare_samples, rendered, ReferenceConfig(), tmp_path, "a", progress=lambda: done.append(1)
            )
            for _ in range(2)
        ]
    assert both[0].result() == both[1].result()
    assert len(done) == len(rendered.targets)


def test_missing_parts_stay_missing(plane_run, tmp_path):
    rendered = read_run(plane_run)
    bare = [dataclasses.replace(view, read_depth=None, read_alpha=None) for view in rendered.targets]
    rendered = dataclasses.replace(rendered, targets=tuple(bare))
    samples = prepare_samples(rendered, ReferenceConfig(references=0), tmp_path, "a")
    batch = make_batch([samples[0].planes()], samples[:1], references=2)
    assert batch.views.depth is not None
    assert batch.views.depth.abs().max() == 0
    assert batch.views.visibility.shape[1] == 2
    assert batch.views.visibility.max() == 0


def test_augmentation_is_determined_by_its_seed_and_keeps_planes_together(plane_run, tmp_path):
    samples = prepare_samples(read_run(plane_run), ReferenceConfig(), tmp_path, "a")
    augmentation = Augmentation(crop=64)
    planes = samples[0].planes()
    one, same, other = (augmentation.random_crop(planes, torch.Generator().manual_seed(s)) for s in (1, 1, 2))
    assert one.shape == (len(planes), 64, 64)
    assert (one == same).all()
    assert not (one == other).all()
    marked = planes.copy()
    marked[3:6] = marked[:3]
    turned = augmentation.random_crop(marked, torch.Generator().manual_seed(5))
    assert (turned[3:6] == turned[:3]).all()
    counts = {
        (len(augmentation.drop_references(one, torch.Generator().manual_seed(s))) - FIXED_PLANES)
        // PLANES_PER_REFERENCE
        for s in range(60)
    }
    assert counts == {0, 1, 2, 3}
    every = Augmentation(crop=64, every_reference=True)
    assert all((every.drop_references(one, torch.Generator().manual_seed(s)) == one).all() for s in range(20))


def test_light_is_shared_and_references_differ(plane_run, tmp_path):
    samples = prepare_samples(read_run(plane_run), ReferenceConfig(), tmp_path, "a")
    batch = make_batch([samples[0].planes()], samples[:1], 3)
    batch = dataclasses.replace(batch, views=dataclasses.replace(batch.views, render=batch.photo))
    lit = Augmentation(light=0.2).relight(batch, torch.Generator().manual_seed(0))
    torch.testing.assert_close(lit.views.render, lit.photo)
    assert not torch.allclose(lit.photo, batch.photo, atol=0.02)
    unlit = Augmentation(light=0.0, exposure=0.0).relight(batch, torch.Generator().manual_seed(0))
    torch.testing.assert_close(unlit.views.references, batch.views.references)


def test_references_may_lose_errors_that_longer_fits_do_not_have(plane_run, tmp_path):
    samples = prepare_samples(read_run(plane_run), ReferenceConfig(), tmp_path, "a")
    batch = make_batch([samples[0].planes()], samples[:1], 3)
    still = {"light": 0.0, "exposure": 0.0, "drop_renders": 0.0}
    errors = []
    for overfit in (0.0, 0.7):
        views = Augmentation(**still, overfit=overfit).relight(batch, torch.Generator().manual_seed(0)).views
        torch.testing.assert_close(views.references, batch.views.references)
        assert views.reference_renders is not None
        errors.append((views.references - views.reference_renders).abs().mean())
    assert 0.3 * errors[0] < errors[1] < errors[0]


@pytest.fixture(scope="module")
def fine_set(tmp_path_factory):
    """A run at 48x64 whose photos are known at 192x256 too."""
    folders = tmp_path_factory.mktemp("runs")
    coarse = read_run(write_plane_run(folders / "coarse"))
    fine = read_run(write_plane_run(folders / "fine", size=(192, 256)))
    photos = [Photo(v.name, v.camera, v.read_photo) for v in (*fine.targets, *fine.references)]
    return attach_fine_photos(coarse, Scene("plane", tuple(photos), (), ()))


def test_a_fine_sample_is_what_the_enhancer_sees(fine_set, tmp_path):
    reference_config = ReferenceConfig(fine=True)
    samples = prepare_samples(fine_set, reference_config, tmp_path, "a")
    batch = make_batch([samples[0].planes()], samples[:1], 3, [samples[0].fine_planes()])
    view = fine_set.targets[0]
    target = read_target(view)
    seen = build_network_input(target, reference_config.align(target, view, ReferencePool(fine_set.references)))
    torch.testing.assert_close(batch.photo[0], view.read_fine_photo())
    assert seen.fine_references is not None
    assert batch.views.fine_references is not None
    assert batch.views.fine_references.shape == (1, 3, 3, 192, 256)
    assert seen.fine_references.dtype == torch.float16
    torch.testing.assert_close(batch.views.fine_references, seen.fine_references.float(), rtol=0, atol=0.5 / 255 + 1e-6)
    assert prepare_samples(fine_set, reference_config, tmp_path, "a") == samples


def test_fine_crops_lie_where_the_crops_lie(fine_set, tmp_path):
    samples = prepare_samples(fine_set, ReferenceConfig(fine=True), tmp_path, "a")
    calm = Augmentation(crop=32, light=0.0, exposure=0.0)
    crops, counts = Crops(samples, calm), set()
    for seed in range(12):
        item = crops[seed % len(samples), seed]
        batch = Collate(3, calm)([item])
        pooled = torch.nn.functional.avg_pool2d(batch.photo, 4)
        low = torch.from_numpy(item[0][3:6])[None].float() / 255
        assert batch.photo.shape == (1, 3, 128, 128)
        assert (pooled - low).abs().mean() < 0.5 * (pooled.flip(-1) - low).abs().mean()
        views = batch.views
        shown = views.visibility > 0.99
        again = torch.nn.functional.avg_pool2d(views.fine_references[0], 4)[None]
        assert ((again - views.references).abs() * shown).mean() < 0.05
        counts.add(int((views.visibility.amax((2, 3, 4)) > 0).sum()))
        assert bool(
            (views.fine_references[0].amax((1, 2, 3)) > 0).sum() == (views.references[0].amax((1, 2, 3)) > 0).sum()
        )
    assert len(counts) > 1


def test_ordinary_samples_keep_their_names_and_their_index(plane_run, tmp_path):
    content = {
        "layout": 5,
        "identity": "a",
        "reference_config": reference_config_of(ReferenceConfig()),
        "held_out": True,
    }
    assert set(content["reference_config"]) == {"warp", "references", "candidates"}
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]
    (sample, *_) = prepare_samples(read_run(plane_run), ReferenceConfig(), tmp_path, "a")
    assert digest in sample.path
    (index,) = tmp_path.glob("*/index.json")
    assert "fine" not in json.loads(index.read_text())[0]
    assert sample.fine_planes() is None
    assert reference_config_of(ReferenceConfig(fine=True))["fine"] is True


def test_a_fine_preparation_needs_fine_photos(plane_run, tmp_path):
    with pytest.raises(InputError, match="no photo of 4 times"):
        prepare_samples(read_run(plane_run), ReferenceConfig(fine=True), tmp_path, "a")
    with pytest.raises(InputError, match="finer="):
        RunSamples(ReferenceConfig(fine=True), tmp_path)


def test_a_run_gives_at_most_so_many_views_spread_evenly(tmp_path_factory, other_plane_run, tmp_path):
    many = write_plane_run(tmp_path_factory.mktemp("runs") / "many", views=20, size=(16, 16))
    samples = RunSamples(ReferenceConfig(references=0), tmp_path, progress=False)
    data = RunsData([str(many)], [str(other_plane_run)], dataclasses.replace(samples, views_per_run=2))
    data.setup()
    names = [sample.name.split("/")[1] for sample in data.sources[0]]
    assert names == ["view_004.png", "view_012.png"]
    whole = RunsData([str(many)], [str(other_plane_run)], samples)
    whole.setup()
    assert len(whole.sources[0]) == 5


@pytest.mark.parametrize(("side", "held_out"), [("test", True), ("train", False)])
def test_renders_written_again_in_place_are_prepared_again(plane_run, tmp_path, side, held_out):
    run = Path(shutil.copytree(plane_run, tmp_path / "run"))
    samples = RunSamples(ReferenceConfig(references=1), tmp_path / "samples", progress=False)
    prepare = samples.held_out if held_out else samples.training_views
    first, again = (prepare(run, 1, lambda: None)[-1] for _ in range(2))
    assert again.path == first.path
    photo = next((run / side / "ours_100/gt").iterdir())
    photo.write_bytes(photo.read_bytes())
    assert prepare(run, 1, lambda: None)[-1].path != first.path
