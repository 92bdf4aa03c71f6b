"""The job ``plan_study`` on a tiny run: records of every plan, the page from records alone, what is missing."""

from collections.abc import Callable
from pathlib import Path

import pytest
from omegaconf import DictConfig, open_dict

from ablations.jobs import plan_study
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.metrics.records import read_records
from support.bright_weights import bright_network
from support.job_config import job_config, run_job
from support.synthetic_runs import write_plane_run


@pytest.fixture
def configured(tmp_path, monkeypatch) -> Callable[..., DictConfig]:
    """The job's configuration for one scene whose fit is a tiny run, and one that is not fitted."""
    save_weights(tmp_path / "w.safetensors", bright_network(0.2, levels=2), ReferenceConfig(), {})
    fit = write_plane_run(tmp_path / "fit/plane-3dgs-0", views=8, size=(32, 48))

    def fitted(cfg: DictConfig, cell) -> Path:
        if cell.scene != "plane":
            raise InputError(cell.scene, "is not fitted", "gaussian-enhancer fit")
        return fit

    monkeypatch.setattr(plan_study, "fitted_cell", fitted)

    def of(*overrides: str) -> DictConfig:
        paths = [f"runs={tmp_path}", f"results={tmp_path / 'results'}", f"markdown={tmp_path / 'docs/results/plan.md'}"]
        quick = ["lpips=[]", "repeats=1", f"weights={tmp_path / 'w.safetensors'}", "runtime.threads=1"]
        cfg = job_config("plan_study", *paths, *quick, *overrides)
        with open_dict(cfg):
            cfg.worlds.plans.auto = ["plan=auto", "plan.small=0"]  # the planes are small
            cfg.worlds.cells = {"plane": {"fit": [], "every": 1}, "absent": {"fit": [], "every": 1}}
        return cfg

    return of


def test_every_plan_is_measured_on_the_same_views_and_the_page_is_made_of_the_records(configured, tmp_path):
    ratio = run_job(plan_study.run, configured())
    assert ratio is not None
    assert ratio > 0
    records = read_records(tmp_path / "results/leaving_out_test.jsonl")
    whole = {record.variant: record.metrics for record in records if record.kind == "leaving_out"}
    assert set(whole) == {"full", "auto"}
    assert (whole["full"]["candidates_left_out"], whole["auto"]["candidates_left_out"]) == (0, 4)
    assert whole["auto"]["times_faster"] == ratio
    assert whole["full"]["times_faster"] == 1
    views = {(r.variant, r.view) for r in records if r.kind == "quality"}
    assert views == {(plan, view) for plan in whole for view in ("view_000.png", "view_004.png")}
    page = (tmp_path / "docs/results/plan.md").read_text()
    assert "absent: absent: is not fitted" in page
    assert "4 of 10 candidates" in page
    assert "Not measured yet: `gaussian-enhancer plan_study worlds=training`" in page
    assert f"| {ratio:.2f} (" in page
    before = page, (tmp_path / "results/leaving_out.svg").read_text()
    run_job(plan_study.run, configured("records_only=true"))
    assert before == (
        (tmp_path / "docs/results/plan.md").read_text(),
        (tmp_path / "results/leaving_out.svg").read_text(),
    )


def test_an_unknown_plan_is_refused_and_worlds_are_kept_apart(configured):
    with pytest.raises(InputError, match="names no 'bold'"):
        run_job(plan_study.run, configured("shown=bold"))
    seeds = {name: str(configured(f"worlds={name}").worlds.plans) for name in ("test", "training")}
    assert seeds["test"] != seeds["training"]


def test_training_worlds_are_none_of_the_test_worlds():
    fits = {
        name: {word for cell in job_config("plan_study", f"worlds={name}").worlds.cells.values() for word in cell.fit}
        for name in ("test", "training")
    }
    assert "scene.seed=3000" in fits["test"]
    assert "scene.seed=3000" not in fits["training"]
    assert not {word for word in fits["training"] & fits["test"] if "seed" in word}
