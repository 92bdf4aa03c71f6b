import dataclasses

import torch

from gaussian_enhancer.enhance.alignment import Unwarped
from gaussian_enhancer.enhance.prepare import Pool, Preparation, join, read_target
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.train.augment import Augmentation
from gaussian_enhancer.train.samples import EACH, FIXED, batch_of, prepare_samples


def test_a_sample_is_what_the_enhancer_sees(plane_run, tmp_path):
    rendered, preparation = read_run(plane_run), Preparation()
    samples = prepare_samples(rendered, preparation, tmp_path, "a")
    batch = batch_of([samples[0].planes()], samples[:1], preparation.references)
    view = rendered.targets[0]
    target = read_target(view)
    seen = join(target, preparation.align(target, view, Pool(rendered.references)))
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
    first = prepare_samples(rendered, Preparation(), tmp_path, "a", progress=lambda: done.append(1))
    again = prepare_samples(rendered, Preparation(), tmp_path, "a", progress=lambda: done.append(1))
    assert first == again
    assert len(done) == len(rendered.targets)
    other = prepare_samples(rendered, Preparation(Unwarped(), 2, 2), tmp_path, "a")
    assert other[0].path != first[0].path
    assert prepare_samples(rendered, Preparation(), tmp_path, "b")[0].path != first[0].path


def test_missing_parts_stay_missing(plane_run, tmp_path):
    rendered = read_run(plane_run)
    bare = [dataclasses.replace(view, read_depth=None, read_alpha=None) for view in rendered.targets]
    rendered = dataclasses.replace(rendered, targets=tuple(bare))
    samples = prepare_samples(rendered, Preparation(references=0), tmp_path, "a")
    batch = batch_of([samples[0].planes()], samples[:1], references=2)
    assert batch.views.depth is not None
    assert batch.views.depth.abs().max() == 0
    assert batch.views.visibility.shape[1] == 2
    assert batch.views.visibility.max() == 0


def test_augmentation_is_determined_by_its_seed_and_keeps_planes_together(plane_run, tmp_path):
    samples = prepare_samples(read_run(plane_run), Preparation(), tmp_path, "a")
    augmentation = Augmentation(crop=64)
    planes = samples[0].planes()
    one, same, other = (augmentation.cut(planes, torch.Generator().manual_seed(s)) for s in (1, 1, 2))
    assert one.shape == (len(planes), 64, 64)
    assert (one == same).all()
    assert not (one == other).all()
    marked = planes.copy()
    marked[3:6] = marked[:3]
    turned = augmentation.cut(marked, torch.Generator().manual_seed(5))
    assert (turned[3:6] == turned[:3]).all()
    counts = {(len(augmentation.drop(one, torch.Generator().manual_seed(s))) - FIXED) // EACH for s in range(60)}
    assert counts == {0, 1, 2, 3}


def test_light_is_shared_and_references_differ(plane_run, tmp_path):
    samples = prepare_samples(read_run(plane_run), Preparation(), tmp_path, "a")
    batch = batch_of([samples[0].planes()], samples[:1], 3)
    batch = dataclasses.replace(batch, views=dataclasses.replace(batch.views, render=batch.photo))
    lit = Augmentation(light=0.2).relight(batch, torch.Generator().manual_seed(0))
    torch.testing.assert_close(lit.views.render, lit.photo)
    assert not torch.allclose(lit.photo, batch.photo, atol=0.02)
    unlit = Augmentation(light=0.0, exposure=0.0).relight(batch, torch.Generator().manual_seed(0))
    torch.testing.assert_close(unlit.views.references, batch.views.references)
