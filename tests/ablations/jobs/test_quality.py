"""The job ``quality`` on tiny runs: numbers from records, resumption, what is missing, aims that fail."""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hydra import compose
from omegaconf import DictConfig, open_dict

from ablations.jobs import quality
from ablations.suite import evaluation as cells
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.cli import pipeline
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.metrics.pair import measure_pair
from gaussian_enhancer.metrics.records import read_records, write_records
from gaussian_enhancer.runs.instantiate import plain_values
from gaussian_enhancer.runs.run import open_run
from gaussian_enhancer.scene.photos import read_photo
from support.bright_weights import bright_network
from support.failures import interrupt
from support.job_config import initialised, job_config, run_job
from support.synthetic_runs import write_plane_run


@pytest.fixture
def fits(monkeypatch) -> list[DictConfig]:
    """Fitting replaced by writing a tiny run; the fits that were made, in their order."""
    made: list[DictConfig] = []

    def fit(job: DictConfig) -> None:
        made.append(job)
        run = open_run(job, "fit", f"plane-{job.splat._target_.split('.')[-1].lower()}")
        write_plane_run(run.folder, seed=len(made), views=5, size=(32, 48))
        run.finish()

    monkeypatch.setattr(pipeline.fit, "run", fit)
    return made


def network(path: Path, bias: float = 0.0) -> Path:
    """A network that returns the render, or one that adds a constant."""
    save_weights(path, bright_network(bias, levels=2), ReferenceConfig(), {})
    return path


@pytest.fixture
def configured(tmp_path) -> Callable[..., DictConfig]:
    """The job's configuration for one scene and method, with methods of one's own beside the raw one."""

    def of(*overrides: str, **methods: dict[str, object]) -> DictConfig:
        paths = [f"runs={tmp_path / 'runs'}", f"markdown={tmp_path / 'docs/q.md'}", f"records={tmp_path / 'q.jsonl'}"]
        few = ["scenes=[unbounded]", "splats=[3dgs]", "lpips=[]", "backbones=null"]
        cfg = job_config("quality", *paths, *few, "runtime.threads=1", "runtime.progress=false", *overrides)
        with open_dict(cfg):
            cfg.tables = {"lr": {**cfg.tables.lr, "methods": {"raw": {"about": "the render"}, **methods}}}
        return cfg

    return of


def page_of(tmp_path: Path) -> str:
    return (tmp_path / "docs/q.md").read_text(encoding="utf-8")


def test_numbers_on_the_page_are_those_of_images_on_disk(fits, configured, tmp_path) -> None:
    weights = network(tmp_path / "w.safetensors", bias=0.05)
    gain = run_job(quality.run, configured(ours={"role": "ours", "weights": str(weights)}))
    found = read_records(tmp_path / "q.jsonl")
    assert {(r.scene, r.splat, r.variant) for r in found} == {
        ("unbounded", f"3dgs/{density}", f"lr/{method}")
        for density in ("dense", "sparse")
        for method in ("raw", "ours")
    }
    differences = []
    for density in ("dense", "sparse"):
        means = {}
        for method in ("raw", "ours"):
            mine = [r for r in found if (r.splat, r.variant) == (f"3dgs/{density}", f"lr/{method}")]
            means[method] = sum(r.metrics["psnr_aligned"] or 0 for r in mine) / len(mine)
            for record in mine:
                part = "renders" if method == "raw" else "enhanced"
                source = f"fit/{record.run}" if method == "raw" else f"enhance/{record.run}-*"
                (image,) = (tmp_path / "runs").glob(f"{source}/test/ours_100/{part}/{record.view}")
                (photo,) = (tmp_path / "runs").glob(f"fit/{record.run}/test/ours_100/gt/{record.view}")
                assert record.metrics == measure_pair(read_photo(image), read_photo(photo)).metrics
        differences.append(means["ours"] - means["raw"])
        shown = f"| unbounded | 3dgs/{density} | {len(mine)} | {means['raw']:.2f} | {means['ours']:.2f} ("
        assert shown in page_of(tmp_path)
    assert gain == pytest.approx(sum(differences) / 2)


def test_sparse_and_dense_are_fitted_as_their_jobs_are_and_measured_on_the_views_asked_for(
    fits, configured, tmp_path
) -> None:
    run_job(quality.run, configured(ours={"role": "ours", "weights": str(network(tmp_path / "w.safetensors"))}))
    dense, sparse = fits
    assert (dense.scene.seed, dense.settings.steps, dense.scene.split.train_every) == (2000, 1000, 1)
    assert (sparse.scene.split.train_every, sparse.scene.split.unused_as_test) == (3, True)
    views = {density: set() for density in ("dense", "sparse")}
    for record in read_records(tmp_path / "q.jsonl"):
        views[record.splat.split("/")[1]].add(record.view)
    assert views == {"dense": {"view_000.png", "view_004.png"}, "sparse": {"view_000.png"}}


def test_what_was_done_is_not_done_again_and_changed_weights_are(fits, configured, tmp_path, monkeypatch) -> None:
    weights = network(tmp_path / "w.safetensors")
    enhancements, measurements = [], []
    enhance, measure = pipeline.enhance.run, cells.measure_files

    def measured(files, *rest):
        measurements.append(files)
        return measure(files, *rest)

    monkeypatch.setattr(pipeline.enhance, "run", lambda job: (enhancements.append(job), enhance(job)))
    monkeypatch.setattr(cells, "measure_files", measured)
    ours = {"role": "ours", "weights": str(weights)}
    run_job(quality.run, configured(ours=ours))
    assert (len(fits), len(enhancements), len(measurements)) == (2, 2, 4)
    before, page = (tmp_path / "q.jsonl").read_text(), page_of(tmp_path)
    run_job(quality.run, configured(ours=ours))
    assert (len(fits), len(enhancements), len(measurements)) == (2, 2, 4)
    assert ((tmp_path / "q.jsonl").read_text(), page_of(tmp_path)) == (before, page)
    network(weights, bias=0.1)
    run_job(quality.run, configured(ours=ours))
    assert (len(fits), len(enhancements), len(measurements)) == (2, 4, 6)
    assert page_of(tmp_path) != page


def test_a_killed_study_goes_on(fits, configured, tmp_path, monkeypatch) -> None:
    cfg = configured(ours={"role": "ours", "weights": str(network(tmp_path / "w.safetensors"))})
    enhance = pipeline.enhance.run

    monkeypatch.setattr(pipeline.enhance, "run", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run_job(quality.run, cfg)
    assert not (tmp_path / "q.jsonl").exists()
    monkeypatch.setattr(pipeline.enhance, "run", enhance)
    run_job(quality.run, cfg)
    assert len(fits) == 2


def test_an_aim_that_fails_is_said_to_fail_and_frames_made_worse_are_named(fits, configured, tmp_path) -> None:
    methods = {
        "ours": {"role": "ours", "weights": str(network(tmp_path / "w.safetensors"))},
        "worse": {"role": "ours", "weights": str(network(tmp_path / "v.safetensors", bias=0.6))},
    }
    assert run_job(quality.run, configured("+tables.lr.allowed.psnr=0.02", **methods)) is not None
    page = page_of(tmp_path)
    assert "| ours | unbounded | psnr +1 or better | +0.0000 | **missed** |" in page
    assert "| ours | all | no frame loses more than 0.02 in psnr_aligned | 0 of 3 frames do | met |" in page
    assert re.search(r"\| worse \| all \| no frame .* psnr \| 3 of 3 frames do \| \*\*missed\*\* \|", page)
    named = next(line for line in page.splitlines() if line.startswith("- `worse`, more than 0.02 in `psnr`"))
    for place in ("dense view_000.png", "dense view_004.png", "sparse view_000.png"):
        assert f"unbounded 3dgs/{place} (-" in named


def test_missing_weights_are_named_and_leave_aims_open(fits, configured, tmp_path) -> None:
    methods = {
        "gone": {"role": "other", "weights": "gone.safetensors"},
        "untrained": {"role": "other", "train": ["+recipe=lr", "seed=77"]},
        "unknown": {"role": "other", "train": ["+recipe=lr", "fusion=unheard_of"]},
        "ours": {"role": "ours", "weights": str(network(tmp_path / "w.safetensors"))},
    }
    run_job(quality.run, configured(**methods))
    page = page_of(tmp_path)
    assert "weights gone.safetensors: is neither a file nor a shipped name" in page
    assert "gaussian-enhancer train +recipe=lr seed=77: `untrained` in all 2 scene-splat pairs" in page
    assert "Could not find 'fusion/unheard_of'" in page
    assert "| unbounded | gone | 0 of 2 | missing |" in page
    assert re.search(r"\| ours \| unbounded \| ahead .* .*compared in full with gone, untrained, unknown \| open", page)


def test_a_fit_that_is_not_there_is_fitted_only_if_asked_for(fits, configured, tmp_path) -> None:
    assert run_job(quality.run, configured("fit_missing=false")) is None
    assert not fits
    assert "is not fitted; gaussian-enhancer fit scene=unbounded scene.seed=2000 splat=3dgs" in page_of(tmp_path)


def test_the_page_can_be_written_again_from_the_records_alone(fits, configured, tmp_path) -> None:
    ours = {"role": "ours", "weights": str(network(tmp_path / "w.safetensors"))}
    run_job(quality.run, configured(ours=ours))
    page = page_of(tmp_path)
    (tmp_path / "docs/q.md").unlink()
    (tmp_path / "runs").rename(tmp_path / "elsewhere")
    run_job(quality.run, configured("records_only=true", ours=ours))
    assert page_of(tmp_path) == page
    assert len(fits) == 2


def test_one_scene_measured_again_leaves_the_records_of_the_others(fits, configured, tmp_path) -> None:
    run_job(quality.run, configured())
    records = read_records(tmp_path / "q.jsonl")
    other = dataclasses.replace(records[0], scene="outdoor")
    write_records(tmp_path / "q.jsonl", [*records, other])
    run_job(quality.run, configured())
    again = read_records(tmp_path / "q.jsonl")
    assert other in again
    assert len(again) == len(records) + 1


def test_one_splat_measured_again_leaves_the_records_of_the_others(fits, configured, tmp_path) -> None:
    def of_all_scenes(*overrides: str) -> DictConfig:
        cfg = configured("scenes=null", *overrides)
        cfg.groups = {"one": {**cfg.groups.procedural, "scenes": {"unbounded": cfg.groups.procedural.scenes.unbounded}}}
        return cfg

    run_job(quality.run, of_all_scenes("splats=null", "splat_choices=[3dgs]"))
    records = read_records(tmp_path / "q.jsonl")
    other = dataclasses.replace(records[0], splat="2dgs/dense")
    write_records(tmp_path / "q.jsonl", [*records, other])
    run_job(quality.run, of_all_scenes("splats=[3dgs]"))
    assert set(map(str, read_records(tmp_path / "q.jsonl"))) == set(map(str, [*records, other]))
    run_job(quality.run, of_all_scenes("splats=null", "splat_choices=[3dgs]"))
    assert other not in read_records(tmp_path / "q.jsonl")


@pytest.mark.parametrize(
    ("override", "found"),
    [
        ("scenes=[nowhere]", "scenes: names 'nowhere'"),
        ("splats=[4dgs]", "splats: names '4dgs'"),
        ("tables.lr.baseline=bicubic", "baseline: is 'bicubic'"),
    ],
)
def test_unknown_names_are_refused_before_anything_is_done(fits, configured, override, found) -> None:
    with pytest.raises(InputError, match=found):
        run_job(quality.run, configured(override))
    assert not fits


def test_a_row_without_a_role_is_refused(configured) -> None:
    with pytest.raises(InputError, match="choose other or ours"):
        run_job(quality.run, configured(ours={"weights": "lr_tiny"}))


def test_the_weights_of_a_training_are_found_where_the_job_train_files_them(configured) -> None:
    from gaussian_enhancer.cli.train import naming_configuration

    trained = ["+recipe=lr", "size=tiny"]
    cfg = configured(ours={"role": "ours", "train": trained})
    with initialised():
        with pytest.raises(InputError, match="not trained yet"):
            cells.method_weights(cfg, cfg.tables.lr.methods.ours)
        run = open_run(naming_configuration(compose("train", [*trained, f"runs={cfg.runs}"])), "train", "lr")
        with pytest.raises(InputError, match="being trained"):
            cells.method_weights(cfg, cfg.tables.lr.methods.ours)
        run.finish()
        assert Path(cells.method_weights(cfg, cfg.tables.lr.methods.ours)).parent == run.folder


def test_the_page_is_made_without_the_captures_folder(monkeypatch) -> None:
    monkeypatch.delenv("GAUSSIAN_ENHANCER_DATA", raising=False)
    assert plain_values(job_config("quality", "records_only=true"))["backbones"] is None
