"""Training of IBGS's residual on one fit: resumable, without held-out views, and it learns."""

import dataclasses
import json
import shutil
from pathlib import Path

import pytest
import torch

from ablations.ibgs.method import IBGS, ResidualEnhancer
from ablations.ibgs.network import IBGSResidual
from ablations.ibgs.sources import SourceChoice
from ablations.ibgs.training import (
    ResidualSettings,
    TrainedResidual,
    corrected,
    drawn,
    loss,
    train_residual,
    training_views,
)
from gaussian_enhancer.align.references import ReferencePool, read_target
from gaussian_enhancer.checkpoint import WEIGHTS
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.renders import read_run

FEW = ResidualSettings(steps=6, crop=32, save_every=2)


class StoppedError(Exception):
    """Ends a training in its middle."""


def stop_at(last: int):
    def progress(step: int) -> None:
        if step == last:
            raise StoppedError

    return progress


def test_a_resumed_training_ends_as_an_uninterrupted_one(plane_run, tmp_path):
    views = training_views(read_run(plane_run), SourceChoice(), exposure=True)
    whole = train_residual(views, FEW, tmp_path)
    (tmp_path / "other").mkdir()
    with pytest.raises(StoppedError):
        train_residual(views, FEW, tmp_path / "other", stop_at(5))
    done: list[int] = []
    again = train_residual(views, FEW, tmp_path / "other", done.append)
    assert done == [5, 6]
    for name, value in whole.state_dict().items():
        assert torch.equal(again.state_dict()[name], value), name
    with pytest.raises(InputError, match="other settings"):
        train_residual(views, dataclasses.replace(FEW, lr=5e-4), tmp_path / "other")


def test_training_sees_each_training_view_with_the_others_as_sources_and_no_held_out_view(plane_run):
    rendered = read_run(plane_run)

    def refused() -> torch.Tensor:
        raise AssertionError("a held-out view was read")

    hidden = [dataclasses.replace(view, read=refused, read_photo=refused) for view in rendered.targets]
    views = training_views(dataclasses.replace(rendered, targets=tuple(hidden)), SourceChoice(), exposure=False)
    assert len(views) == len(rendered.references)
    for view, one in zip(rendered.references, views, strict=True):
        assert torch.equal(one.photo, view.read_photo())
        assert torch.equal(one.inputs.render[0], view.read())
        visible = one.inputs.visible[0]
        assert visible.any()
        same = (one.inputs.colours[0] == one.photo).all(1, keepdim=True) & visible
        assert same.sum() < 0.01 * visible.sum()


def test_it_learns(plane_run, tmp_path):
    settings = ResidualSettings(steps=100, crop=48, lr=5e-3)
    views = training_views(read_run(plane_run), SourceChoice(), settings.exposure)
    torch.manual_seed(0)
    before = loss(IBGSResidual(), drawn(views, settings, 1000), 0.2)
    after = loss(train_residual(views, settings, tmp_path), drawn(views, settings, 1000), 0.2)
    assert after < 0.9 * before


def test_the_loss_is_that_of_the_paper():
    settings = ResidualSettings()
    assert settings.lr_at(0) == settings.lr
    assert settings.lr_at(settings.steps) == pytest.approx(0)
    with pytest.raises(InputError, match="crop: is 0"):
        ResidualSettings(crop=0)
    with pytest.raises(InputError, match="dissimilarity: is 2"):
        ResidualSettings(dissimilarity=2.0)


def untrained() -> TrainedResidual:
    return TrainedResidual(IBGSResidual(), "plane-0", 100, ResidualSettings(), SourceChoice())


def test_untrained_it_returns_the_render_and_exposure_is_an_affine_map_of_it(plane_run):
    rendered = read_run(plane_run)
    pool = ReferencePool(rendered.references)
    for view in rendered.targets:
        target = read_target(view)
        plain = ResidualEnhancer(untrained(), exposure=False)(view, target, pool)
        torch.testing.assert_close(plain, target.image, atol=1e-6, rtol=0)
        matched = ResidualEnhancer(untrained())(view, target, pool)
        assert not torch.allclose(matched, target.image, atol=1e-3)


def test_what_is_written_is_read_again(plane_run, tmp_path):
    views = training_views(read_run(plane_run), SourceChoice(angle=20.0), exposure=True)
    trained = TrainedResidual(train_residual(views, FEW, tmp_path), "plane-0", 100, FEW, SourceChoice(angle=20.0))
    trained.save(tmp_path / WEIGHTS)
    found = TrainedResidual.load(tmp_path / WEIGHTS)
    assert (found.fit, found.step, found.settings, found.choice) == ("plane-0", 100, FEW, SourceChoice(angle=20.0))
    seen = views[0].inputs
    images = [corrected(one.network, seen, views[0].exposure[None]) for one in (trained, found)]
    torch.testing.assert_close(*images, atol=2e-3, rtol=0)


def test_the_job_trains_once_and_convergence_measures_its_network(plane_run, tmp_path, job, capsys):
    fit = tmp_path / "fits/plush-3dgs-0"
    shutil.copytree(plane_run, fit)
    words = ("settings.steps=4", "settings.crop=32", f"runs={tmp_path}/runs", "runtime.progress=false")
    for step in (50, 100):
        job("ibgs", f"fit={fit}", f"step={step}", *words)
    assert "parameters, 6 views, 4 steps" in capsys.readouterr().err
    job("ibgs", f"fit={fit}", *words)
    assert "trained already" in capsys.readouterr().err
    names = {folder.name.rpartition("-")[0] for folder in (tmp_path / "runs/ibgs").iterdir()}
    assert names == {"plush-50", "plush-100"}
    assert not list((tmp_path / "runs").rglob("checkpoint.pt"))

    found = IBGS.from_patterns([f"{tmp_path}/runs/ibgs/*"])
    assert set(found.trainings) == {(fit.name, 50), (fit.name, 100)}
    with pytest.raises(InputError, match=r"has no training on .* at step 7"):
        found(fit, 7)
    with pytest.raises(InputError, match="names no training"):
        IBGS.from_patterns([])

    words = ("row_table=same_fits", "methods=[average,ibgs,'ibgs:without_exposure']", f"runs=[{fit}]", "last=true")
    written = (f"records={tmp_path}/found.jsonl", f"page={tmp_path}/page.md")
    job("convergence", *words, f"ibgs=[{tmp_path}/runs/ibgs/*]", *written)
    rows = [json.loads(line) for line in (tmp_path / "found.jsonl").read_text().splitlines()]
    assert {row["step"] for row in rows} == {100}
    methods = {"average of render and references", "ibgs", "ibgs without exposure"}
    assert {row["method"] for row in rows} == methods
    page = (tmp_path / "page.md").read_text()
    assert page.startswith("# Peers on the same fits")
    assert all(page.count(f"| {method} |") == 2 for method in methods)


def test_two_trainings_on_one_snapshot_are_refused(plane_run, tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "done").write_text(json.dumps({"digest": name}))
        untrained().save(tmp_path / name / WEIGHTS)
    with pytest.raises(InputError, match="of the same fit and step"):
        IBGS.from_patterns([f"{tmp_path}/*"])


def test_no_training_views_are_refused(tmp_path: Path):
    with pytest.raises(InputError, match="no training views"):
        train_residual([], FEW, tmp_path)
