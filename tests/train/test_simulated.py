import dataclasses

import pytest
import torch

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.degrade.gates.gate import ArtefactStep, NoGate
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.train.augment import Augmentation
from gaussian_enhancer.train.crops import BalancedDraw, Collate, Crops
from gaussian_enhancer.train.data import Loading, RunsData
from gaussian_enhancer.train.run_samples import RunSamples
from gaussian_enhancer.train.samples import make_batch, prepare_samples, training_targets
from gaussian_enhancer.train.simulated import Simulation
from gaussian_enhancer.types import Batch

CALM = Augmentation(crop=32, exposure=0.0, light=0.0)


class Noisy:
    """A second stage that changes every pixel of image, depth and opacity, and notes what it was shown."""

    def __init__(self):
        self.manual, self.real = [], []

    def __call__(self, manual, generators, real=None):
        self.manual.append(manual)
        self.real.append(real)
        noise = torch.stack([torch.rand(3, *manual.image.shape[-2:], generator=one) for one in generators])
        depth = None if manual.depth is None else 0.5 * manual.depth
        alpha = None if manual.alpha is None else 0.25 * manual.alpha
        return dataclasses.replace(manual, image=0.5 * manual.image + 0.5 * noise, depth=depth, alpha=alpha)


class Paired(Noisy):
    """A second stage that hands out the real render, and refuses where there is none, as ``paired`` does."""

    def __call__(self, manual, generators, real=None):
        if real is None:
            raise InputError("generator=paired", "got no real renders", "use another")
        return dataclasses.replace(manual, image=real)


class Blurry:
    """A gate that always blurs, strongly."""

    def draw(self, generator):
        return (ArtefactStep("blur", 1.0), ArtefactStep("noise", 0.5, regional=True))


@pytest.fixture(scope="module")
def samples(plane_run, tmp_path_factory):
    return prepare_samples(read_run(plane_run), ReferenceConfig(), tmp_path_factory.mktemp("cache"), "a")


@pytest.fixture(scope="module")
def photos(plane_run, tmp_path_factory):
    rendered = training_targets(read_run(plane_run))
    return prepare_samples(rendered, ReferenceConfig(), tmp_path_factory.mktemp("cache"), "a", held_out=False)


def items(samples, seeds):
    crops = Crops(samples, CALM)
    return [crops[i % len(samples), seed] for i, seed in enumerate(seeds)]


def plain(items):
    planes, samples, _ = zip(*items, strict=True)
    return make_batch(planes, samples, 3)


def same(one, other, tolerance=0.0):
    for name in ("render", "references", "visibility", "depth", "alpha", "depth_unit"):
        torch.testing.assert_close(getattr(one.views, name), getattr(other.views, name), rtol=0, atol=tolerance)
    torch.testing.assert_close(one.photo, other.photo, rtol=0, atol=0)
    assert one.names == other.names


def test_share_one_replaces_renders_and_leaves_photos_and_references(samples):
    chosen = items(samples, [3, 4, 5, 6])
    before, after = plain(chosen), Collate(3, CALM, Simulation(Simulator(NoGate(), Noisy()), 1.0))(chosen)
    torch.testing.assert_close(after.photo, before.photo, rtol=0, atol=0)
    torch.testing.assert_close(after.views.references, before.views.references, rtol=0, atol=0)
    torch.testing.assert_close(after.views.visibility, before.views.visibility, rtol=0, atol=0)
    changed = (after.views.render - before.views.render).abs().flatten(1).mean(1)
    assert bool((changed > 0.05).all())
    torch.testing.assert_close(after.views.depth, 0.5 * before.views.depth)
    torch.testing.assert_close(after.views.alpha, 0.25 * before.views.alpha)


def test_what_is_simulated_is_the_photo_before_it_is_relit(samples):
    chosen = items(samples, [3, 4])
    second = Noisy()
    lit = dataclasses.replace(CALM, light=0.5)
    Collate(3, lit, Simulation(Simulator(NoGate(), second), 1.0))(chosen)
    torch.testing.assert_close(second.manual[0].image, plain(chosen).photo)
    clean = Collate(3, lit, Simulation(Simulator(NoGate()), 1.0))(chosen)
    torch.testing.assert_close(clean.views.render, clean.photo)
    assert not torch.allclose(clean.photo, plain(chosen).photo, atol=0.02)


def test_a_crop_is_simulated_alike_in_every_batch(samples):
    seeds = list(range(10, 18))
    chosen = items(samples, seeds)
    collate = Collate(3, CALM, Simulation(Simulator(NoGate(), Noisy()), 0.5))
    whole, real = collate(chosen), plain(chosen)
    drawn = [bool((a - b).abs().max() > 0) for a, b in zip(whole.views.render, real.views.render, strict=True)]
    assert {True, False} == set(drawn)
    for order in ([7, 6, 5, 4, 3, 2, 1, 0], [2], [5, 1]):
        other = collate([chosen[i] for i in order])
        torch.testing.assert_close(other.views.render, whole.views.render[order], rtol=0, atol=0)
        torch.testing.assert_close(other.views.depth, whole.views.depth[order], rtol=0, atol=0)
    again = items(samples, [10, 11])
    different = collate(items(samples, [110, 111]))
    torch.testing.assert_close(collate(again).views.render, whole.views.render[:2], rtol=0, atol=0)
    assert not torch.allclose(different.views.render, whole.views.render[:2])


def test_stage_one_is_determined_by_the_seed_too(samples):
    chosen = items(samples, [1, 2, 3])
    collate = Collate(3, CALM, Simulation(Simulator(Blurry()), 1.0))
    whole = collate(chosen)
    assert bool(((whole.views.render - whole.photo).abs().flatten(1).mean(1) > 0.01).all())
    for i in range(3):
        # Convolutions of one sample and of three differ by rounding, hence by one level of 8 bits here and there.
        one = collate([chosen[i]]).views.render[0]
        torch.testing.assert_close(one, whole.views.render[i], rtol=0, atol=1.01 / 255)


def test_paired_is_shown_the_real_render_of_the_same_crop(samples):
    chosen = items(samples, [3, 4, 5])
    real = plain(chosen)
    batch = Collate(3, CALM, Simulation(Simulator(NoGate(), Paired()), 1.0))(chosen)
    torch.testing.assert_close(batch.views.render, real.views.render)
    second = Noisy()
    Collate(3, CALM, Simulation(Simulator(NoGate(), second), 1.0))(chosen)
    torch.testing.assert_close(second.real[0], real.views.render, rtol=0, atol=0)


def test_the_fits_own_renders_are_kept_and_lit_like_the_rest(samples):
    chosen = items(samples, [3, 4, 5])
    bright = dataclasses.replace(CALM, light=0.3)
    batch = Collate(3, bright, Simulation(Simulator(NoGate(), Noisy()), 1.0))(chosen)
    torch.testing.assert_close(batch.real, Collate(3, bright)(chosen).views.render)
    assert Collate(3, bright)(chosen).real is None
    assert not torch.equal(batch.real, batch.views.render)


def test_a_simulators_training_validates_on_simulated_renders_of_held_out_views(plane_run, other_plane_run, tmp_path):
    simulator = Simulator(NoGate(), Noisy())
    samples = RunSamples(ReferenceConfig(), tmp_path, progress=False)
    simulation = Simulation(simulator, 1.0, validation=True)
    data = RunsData([str(plane_run)], [str(other_plane_run)], samples, simulation=simulation)
    data.setup()
    batches, again = list(data.val_dataloader()), list(data.val_dataloader())
    assert all(not torch.equal(batch.real, batch.views.render) for batch in batches)
    assert all(torch.equal(a.views.render, b.views.render) for a, b in zip(batches, again, strict=True))
    with pytest.raises(InputError, match="training_views"):
        Simulation(simulator, 1.0, training_views=True, validation=True)


def test_training_views_are_simulated_always_and_never_a_pair(samples, photos):
    second = Noisy()
    chosen = items([*samples, *photos], range(len(samples) + len(photos)))
    batch = Collate(3, CALM, Simulation(Simulator(NoGate(), second), 1e-9))(chosen)
    first = len(samples)
    kept = Batch(_part(batch.views, first), batch.photo[:first], batch.names[:first])
    same(kept, plain(chosen[:first]))
    changed = (batch.views.render[first:] - batch.photo[first:]).abs().flatten(1).mean(1)
    assert bool((changed > 0.05).all())
    assert second.real == [None]
    with pytest.raises(InputError, match="no real renders"):
        Collate(3, CALM, Simulation(Simulator(NoGate(), Paired()), 1.0))(chosen[first:])


def _part(views, count):
    fields = {field.name: getattr(views, field.name) for field in dataclasses.fields(views)}
    return dataclasses.replace(views, **{name: None if f is None else f[:count] for name, f in fields.items()})


def test_training_views_hold_their_photo_for_a_render_and_never_refer_to_themselves(plane_run, photos):
    run = read_run(plane_run)
    assert [sample.name.split("/")[1] for sample in photos] == [view.name for view in run.references]
    for sample, view in zip(photos, run.references, strict=True):
        planes = sample.planes()
        assert (planes[:3] == planes[3:6]).all()
        assert not sample.held_out
        assert sample.has_depth
        batch = make_batch([planes], [sample], 3)
        assert view.read_photo is not None
        torch.testing.assert_close(batch.photo[0], view.read_photo())
        shown = batch.views.visibility[0, :, 0] > 0.99
        apart = (batch.views.references[0] - batch.photo).abs().mean(1)
        assert all(bool(apart[i][shown[i]].max() > 0.02) for i in range(3) if bool(shown[i].any()))


def test_what_is_unknown_stays_unknown(samples):
    bare = dataclasses.replace(samples[0], has_depth=False, has_alpha=False)
    second = Noisy()
    chosen = items([samples[0], bare], [1, 2])
    batch = Collate(3, CALM, Simulation(Simulator(NoGate(), second), 1.0))(chosen)
    assert [(view.depth is None, view.alpha is None) for view in second.manual] == [(False, False), (True, True)]
    assert float(batch.views.depth[1].abs().max()) == 0
    torch.testing.assert_close(batch.views.alpha[1], plain(chosen).views.alpha[1])


def test_draws_without_simulation_are_what_they_were():
    # From the version before there was a simulator.
    before = [(6, 764394165), (4, 730271783), (3, 887690403), (6, 1460117715), (3, 1756261137), (1, 313390460)]
    assert list(BalancedDraw([3, 4], 6, seed=1)) == before


def test_further_samples_are_drawn_for_simulated_crops_alone():
    simulation = Simulation(Simulator(NoGate()), 0.5)
    draws = list(BalancedDraw([2, 3], 2000, 0, [4, 5], simulation.is_simulated))
    held_out = {0, 1, 6, 7, 8}
    assert {number for number, _ in draws} == set(range(14))
    assert all(simulation.is_simulated(seed) for number, seed in draws if number not in held_out)
    real = [number for number, seed in draws if not simulation.is_simulated(seed)]
    assert set(real) == held_out
    assert 900 < len(real) < 1100
    assert 900 < sum(number < 6 for number, _ in draws) < 1100


class Noting:
    """A gate that lets nothing through and notes the first number of each sample's source."""

    def __init__(self):
        self.first = []

    def draw(self, generator):
        self.first.append(float(torch.rand((), generator=generator)))
        return ()


def test_whether_a_crop_is_simulated_says_nothing_of_how(samples):
    gate = Noting()
    Collate(3, CALM, Simulation(Simulator(gate), 0.5))(items(samples, range(200)))
    assert 70 < len(gate.first) < 130
    assert abs(sum(gate.first) / len(gate.first) - 0.5) < 0.12  # four standard errors


@pytest.mark.parametrize("share", [-0.1, 0.0, 1.5])
def test_shares_out_of_range_are_refused(share):
    with pytest.raises(InputError, match="share"):
        Simulation(Simulator(NoGate()), share)


def loaded(plane_run, other_plane_run, cache, simulation=None, workers=0):
    data = RunsData(
        [str(plane_run)],
        [str(other_plane_run)],
        RunSamples(ReferenceConfig(), cache, progress=False),
        Loading(batch_size=2, workers=workers),
        Augmentation(crop=32),
        simulation,
        steps_per_epoch=4,
    )
    data.setup()
    return data, list(data.train_dataloader())


def test_batches_of_a_run(plane_run, other_plane_run, tmp_path):
    _, before = loaded(plane_run, other_plane_run, tmp_path)
    simulation = Simulation(Simulator(NoGate(), Noisy()), 0.5, training_views=True)
    on, alone = loaded(plane_run, other_plane_run, tmp_path, simulation)
    _, workers = loaded(plane_run, other_plane_run, tmp_path, simulation, workers=2)
    for one, other in zip(alone, workers, strict=True):
        same(one, other)
    assert any(bool((a.photo != b.photo).any()) for a, b in zip(before, alone, strict=True))
    train = {view.name for view in read_run(plane_run).references}
    assert {sample.name.split("/")[1] for source in on.sources for sample in source if not sample.held_out} == train
    assert all(sample.held_out for sample in on.held_out)
    assert not train & {batch.names[0].split("/")[1] for batch in on.val_dataloader()}
