"""Samples that are not finite: dropped by name, counted, without weight; too many fail the training."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch
from test_train import configured, settings

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.loss.terms import DSSIM, Charbonnier
from gaussian_enhancer.loss.weighted_sum import Weighted, WeightedLoss
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.train.data import RunsData
from gaussian_enhancer.train.metrics import gains
from gaussian_enhancer.train.module import EnhancerModule
from gaussian_enhancer.train.non_finite import MIN_CROPS, NonFiniteFilter, finite_samples, refuse_bad, zero_samples
from gaussian_enhancer.train.run_samples import RunSamples
from gaussian_enhancer.train.samples import Sample, prepare_samples
from gaussian_enhancer.types import Batch, NetworkInput


def batch(size: int = 4) -> Batch:
    draw = torch.Generator().manual_seed(0)

    def image(*shape: int) -> torch.Tensor:
        return torch.rand(size, *shape, 16, 16, generator=draw)

    views = NetworkInput(image(3), image(2, 3), image(2, 1), 1 + image(1), image(1), torch.ones(size), image(2, 3))
    return Batch(views, image(3), tuple(f"sample {i}" for i in range(size)))


def module(share: float = 1.0) -> EnhancerModule:
    torch.manual_seed(0)
    network = SIF((8, 8), (1, 1))
    torch.nn.init.normal_(network.decode.head.weight, std=0.1)
    terms = {"photo": Weighted(Charbonnier()), "shape": Weighted(DSSIM(), 0.2)}
    return EnhancerModule(network, WeightedLoss(terms), gains(), partial(torch.optim.AdamW, lr=8e-4), bad_share=share)


def gradients(training: EnhancerModule, given: Batch) -> tuple[torch.Tensor, torch.Tensor]:
    training.network.zero_grad()
    total, _ = training.batch_loss(given)
    total.backward()
    return total.detach(), torch.cat([p.grad.flatten() for p in training.network.parameters() if p.grad is not None])


def spoilt(given: Batch, place: int, part: str, value: float = float("nan")) -> Batch:
    if part == "photo":
        photo = given.photo.clone()
        photo[place].view(-1)[5] = value
        return replace(given, photo=photo)
    image = getattr(given.views, part).clone()
    image[place].view(-1)[5] = value
    return replace(given, views=replace(given.views, **{part: image}))


@pytest.mark.parametrize("part", ["photo", "render", "references", "visibility", "alpha", "reference_renders"])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_bad_sample_weighs_nothing_and_is_named(part, value, capsys):
    """Loss and gradient are those of the whole batch less the sample's share of the mean."""
    training, good = module(), batch()
    total, slope = gradients(training, spoilt(good, 2, part, value))
    rest = [gradients(training, _only(good, place)) for place in (0, 1, 3)]
    assert total == pytest.approx(float(sum(one for one, _ in rest)) / 4, rel=1e-5)
    torch.testing.assert_close(slope, sum(one for _, one in rest) / 4, rtol=1e-4, atol=1e-7)
    assert training.non_finite.counts == {"sample 2": 1}
    assert "sample 2" in capsys.readouterr().err


def test_a_good_batch_is_what_it_was_bit_for_bit():
    training, good = module(), batch()
    expected, parts = training._loss_at_all_scales(training.network.stages(good.views), good.views.render, good.photo)
    total, found = training.batch_loss(good)
    assert torch.equal(total, expected)
    assert all(torch.equal(found[name], value) for name, value in parts.items())
    assert training.non_finite.counts == {}


def test_depth_that_is_not_finite_is_no_reason_to_drop():
    good = batch()
    assert finite_samples(spoilt(good, 1, "depth")).all()


def test_a_batch_without_a_good_sample_moves_nothing():
    training, bad = module(), batch(1)
    total, slope = gradients(training, spoilt(bad, 0, "photo"))
    assert float(total) == 0
    assert len(slope) == sum(p.numel() for p in training.network.parameters())
    assert not slope.any()


def test_weights_that_are_not_finite_end_the_training():
    training = module()
    with torch.no_grad():
        next(training.network.parameters()).fill_(float("nan"))
    with pytest.raises(InputError, match=r"weights that are not finite at step 0; lower optimizer.lr"):
        training.batch_loss(batch())


def test_emptying_keeps_the_others():
    good = batch()
    kept = torch.tensor([True, False, True, True])
    found = zero_samples(spoilt(good, 1, "references"), kept)
    assert torch.equal(found.views.references[kept], good.views.references[kept])
    assert not found.views.references[1].any()
    assert finite_samples(found).all()


def test_too_large_a_share_fails():
    non_finite = NonFiniteFilter(0.01)
    non_finite.add(["a"] * 10)
    non_finite.refuse_many(4)  # ten of the first thousand may be
    non_finite.add(["b"])
    with pytest.raises(InputError, match=r"dropped 11 of 4 crops that are not finite, most often a .10."):
        non_finite.refuse_many(4)
    non_finite.refuse_many(MIN_CROPS + 100)
    non_finite.refuse_many_of_all(1100)
    with pytest.raises(InputError, match="11 of 1000"):
        non_finite.refuse_many_of_all(1000)
    with pytest.raises(InputError, match="bad_share"):
        NonFiniteFilter(1.5)


def test_a_view_that_is_not_finite_is_prepared_by_name_alone(plane_run, tmp_path, capsys):
    rendered = read_run(plane_run)
    first, *others = rendered.targets

    def photo() -> torch.Tensor:
        image = first.read_photo().clone()
        image[0, 3, 4] = float("nan")
        return image

    bad = replace(rendered, targets=(replace(first, read_photo=photo), *others))
    for _ in range(2):  # made, then found in the cache
        samples = prepare_samples(bad, ReferenceConfig(references=1), tmp_path, "a")
        assert [sample.bad for sample in samples] == ["photo", *[""] * len(others)]
    index = next(tmp_path.glob("*/index.json"))
    assert ["bad" in entry for entry in json.loads(index.read_text())] == [True, *[False] * len(others)]
    refuse_bad(["view_000.png: its photo is not finite"], 200, 0.01)
    assert "dropped view_000.png" in capsys.readouterr().err
    with pytest.raises(InputError, match="1 samples of 2"):
        refuse_bad(["view_000.png: its photo is not finite"], 2, 0.01)


def test_a_source_without_a_finite_sample_is_named(plane_run, other_plane_run, tmp_path, monkeypatch):
    held_out = RunSamples.held_out

    def spoil(self, run, *options):
        samples = held_out(self, run, *options)
        return [replace(sample, bad="photo") for sample in samples] if Path(run).name == plane_run.name else samples

    monkeypatch.setattr(RunSamples, "held_out", spoil)
    for trained, validated in ((plane_run, other_plane_run), (other_plane_run, plane_run)):
        samples = RunSamples(ReferenceConfig(), tmp_path, bad_share=1.0, progress=False)
        with pytest.raises(InputError, match="all others of its runs are not finite"):
            RunsData([str(trained)], [str(validated)], samples).setup()


@pytest.fixture
def faulty(monkeypatch):
    """Planes of one view turn into NaN when they become a batch."""
    from gaussian_enhancer.train import crops

    made = crops.make_batch

    def batch_of(planes, samples: tuple[Sample, ...], *arguments) -> Batch:
        found = made(planes, samples, *arguments)
        bad = torch.tensor([sample.name.endswith("view_000.png") for sample in samples])
        return replace(found, photo=torch.where(bad[:, None, None, None], float("nan"), found.photo))

    monkeypatch.setattr(crops, "make_batch", batch_of)


def test_a_training_with_a_bad_sample_ends_or_fails_as_it_is_told(faulty, plane_run, other_plane_run, tmp_path, capsys):
    from gaussian_enhancer.cli.train import run

    options = settings(plane_run, other_plane_run, tmp_path, "trainer.max_steps=4", "save_every=2")
    with pytest.raises(InputError, match=r"crops that are not finite, most often plane-0/view_000.png"):
        run(configured(*options))
    assert "dropped plane-0/view_000.png" in capsys.readouterr().err
    (checkpoint,) = tmp_path.glob("train/*/last.ckpt")
    kept = torch.load(checkpoint, weights_only=True)["dropped"]
    assert list(kept) == ["plane-0/view_000.png"]
    assert run(configured(*options, "bad_share=1.0")) is not None  # the same run, which went on counting
    (card,) = tmp_path.glob("train/*/card.json")
    told = json.loads(card.read_text())["dropped"]
    assert list(told) == list(kept)
    assert told["plane-0/view_000.png"] > kept["plane-0/view_000.png"]


def _only(given: Batch, place: int) -> Batch:
    one = torch.tensor([place])
    views = given.views
    names = ("render", "references", "visibility", "depth", "alpha", "depth_unit", "reference_renders")
    return Batch(NetworkInput(**{n: getattr(views, n)[one] for n in names}), given.photo[one], (given.names[place],))
