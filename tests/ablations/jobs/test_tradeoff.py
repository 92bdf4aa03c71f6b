"""The job ``tradeoff`` on tiny runs: numbers that agree with images, what is missing, the page from records alone."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hydra import compose

from ablations.jobs import tradeoff
from ablations.report import tradeoff_quality
from ablations.tradeoff.settings import Setting, read_studies
from ablations.tradeoff.summary import HIGH, LOW, TIME
from gaussian_enhancer.cli import pipeline
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.presets import read_presets
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.metrics.pair import measure_pair
from gaussian_enhancer.metrics.records import read_records, write_records
from gaussian_enhancer.runs.run import open_run
from gaussian_enhancer.scene.renders import read_run
from support.job_config import QUIET, initialised, job_config, run_job
from support.synthetic_runs import write_plane_run
from support.tiny_suite import SUITE

FASTEST_FIRST = {
    "raw/render": 1.0,
    "lr_tiny/0 references": 2.0,
    "planned/auto": 4.0,
    "lr_tiny/2 references": 5.0,
}
"""Milliseconds."""


def configured(*overrides: str):
    return job_config("tradeoff", SUITE, "scale=tiny", "curves=tiny", "lpips=[]", *QUIET, *overrides)


def started(*overrides: str) -> None:
    run_job(tradeoff.run, configured(*overrides))


def plane_fit(job) -> None:
    """A run in place of a fit: a textured plane, blurred."""
    run = open_run(job, "fit", f"{job.scene.seed}-3dgs")
    write_plane_run(run.folder, seed=int(job.scene.seed), views=6, size=(32, 48))
    run.finish()


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A folder in which the kind quality was measured; not to be written into. `copied` copies it."""
    folder = tmp_path_factory.mktemp("tradeoff")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(pipeline.fit, "run", plane_fit)
        started("kind=quality", "settings=settings.json")
    return folder


def records_of(folder: Path):
    return read_records(folder / "docs/results/tradeoff/quality.jsonl")


def set_times(folder: Path) -> None:
    """Replace measured times, so that the order of the settings is that of `FASTEST_FIRST` on every machine."""

    def timed(record):
        name = record.variant.removeprefix("lr/")
        if name not in FASTEST_FIRST:
            return record
        return replace(record, metrics={**record.metrics, **dict.fromkeys((LOW, TIME, HIGH), FASTEST_FIRST[name])})

    records = records_of(folder)
    write_records(folder / "docs/results/tradeoff/quality.jsonl", map(timed, records))


def test_every_setting_has_a_record_in_every_scene_or_says_why_not(made) -> None:
    records = records_of(made)
    scenes = {"validation/easy/object", "validation/hard/outdoor", "test/easy/object"}
    present = {"raw/render", "lr_tiny/0 references", "lr_tiny/2 references", "planned/auto"}
    absent = {
        "half/float16": "is measured on cuda alone, and this device is cpu",
        "untrained/as trained": "is not made yet at scale tiny",
        "gone/as it was": "is neither a file nor a shipped name",
    }
    assert {(r.scene, r.variant.removeprefix("lr/")) for r in records} == {
        (scene, name) for scene in scenes for name in (*present, *absent)
    }
    for record in records:
        name = record.variant.removeprefix("lr/")
        if name in absent:
            assert record.kind == "missing"
            assert absent[name] in record.reasons["row"]
        else:
            metrics = record.metrics
            assert 0 < metrics[LOW] <= metrics[TIME] <= metrics[HIGH]
            assert metrics["peak_memory_mb"] > 50
            assert record.size == (48, 32)


def test_errors_are_those_of_what_the_enhancer_makes_and_times_those_of_its_size(made) -> None:
    records = [r for r in records_of(made) if r.scene == "test/easy/object"]
    (fit,) = (made / "runs/fit").glob("3000-3dgs-*")
    rendered = read_run(fit)
    view = replace(rendered, targets=rendered.targets[:1])
    photo = view.targets[0].read_photo()
    raw, two = (
        next(r for r in records if r.variant == f"lr/{name}") for name in ("raw/render", "lr_tiny/2 references")
    )
    assert raw.view == two.view == view.targets[0].name
    assert raw.metrics["psnr"] == measure_pair(view.targets[0].read(), photo).metrics["psnr"]
    found = load_weights("lr_tiny")
    config = replace(found.reference_config, references=2, candidates=5)
    (image,) = [one.image for one in EnhancementOptions().enhancer(found, config)(view)]
    assert two.metrics["psnr"] == pytest.approx(measure_pair(image, photo).metrics["psnr"], abs=1e-6)
    assert two.metrics["psnr"] > raw.metrics["psnr"]


def test_the_page_names_fronts_choices_and_what_is_missing(made) -> None:
    page = (made / "docs/results/tradeoff.md").read_text()
    assert "### At the render's own resolution: validation scenes" in page
    assert "![Enhancement: lr_validation](tradeoff/lr_validation.svg)" in page
    assert "| all | cheapest within 0.1 dB of the best |" in page
    assert "| easy | best within 33 ms an image of 0.002 MP |" in page
    assert "`half/float16`: half/float16: is measured on cuda alone" in page
    assert "Not measured yet: `gaussian-enhancer tradeoff kind=numerics`" in page
    drawing = (made / "docs/results/tradeoff/lr_validation.svg").read_text()
    # Labels stand on the front alone, and its best end is one of these two: they differ in time, not in image.
    assert "lr_tiny, 2 references" in drawing or "planned, auto" in drawing
    assert drawing.count('<g id="axes_') == 6  # three groups, two errors
    assert "<script" not in drawing


def test_every_panel_shows_every_setting(copied, monkeypatch) -> None:
    drawn = []
    monkeypatch.setattr(
        tradeoff_quality,
        "work_precision",
        lambda title, panels, columns: drawn.append((title, panels)) or "<svg></svg>",
    )
    started("kind=quality", "records_only=true")
    panels = next(panels for title, panels in drawn if title.endswith("resolution, validation scenes"))
    labels = [f"{curve}, {m.label}" for panel in panels for curve, marks in panel.curves.items() for m in marks]
    assert labels.count("lr_tiny, 2 references") >= 6  # three groups, two errors


def test_the_page_is_made_again_from_records_alone_and_choices_follow_their_limits(copied) -> None:
    page = Path("docs/results/tradeoff.md").read_text()
    shutil.rmtree("runs")
    Path("docs/results/tradeoff.md").unlink()
    started("kind=quality", "records_only=true")
    assert Path("docs/results/tradeoff.md").read_text() == page
    set_times(copied)
    started("kind=quality", "records_only=true", "tradeoff.within=50dB", "tradeoff.budget_ms=1e9")
    lines = Path("docs/results/tradeoff.md").read_text().splitlines()
    (cheapest,) = {line.split("|")[3].strip() for line in lines if "| all | cheapest within 50 dB" in line}
    assert cheapest == "raw/render"
    (best,) = {line.split("|")[3].strip() for line in lines if "| all | best within 1e+09 ms" in line}
    assert best.startswith(("lr_tiny", "planned"))


def test_offers_are_the_front_of_what_the_job_enhance_can_be_asked_for_on_validation_scenes(copied) -> None:
    presets = read_presets(copied / "settings.json")
    assert {one.name for one in presets} <= {"lr_tiny/0 references", "lr_tiny/2 references", "planned/auto"}
    assert [one.psnr for one in presets] == sorted(one.psnr for one in presets)
    file = Path("docs/results/tradeoff/quality.jsonl")
    kept = read_records(file)

    def better_in_test(record):
        metrics = record.metrics | {"psnr": 99.0} if record.scene.startswith("test/") else record.metrics
        return replace(record, metrics=metrics)

    write_records(file, map(better_in_test, kept))
    started("kind=quality", "records_only=true", "settings=settings.json")
    assert read_presets(copied / "settings.json") == presets
    write_records(file, (record for record in kept if not record.scene.startswith("validation/")))
    with pytest.raises(InputError, match="have no record to be made from"):
        started("kind=quality", "records_only=true", "settings=settings.json")


@pytest.mark.parametrize(
    ("override", "found"),
    [
        ("kind=speed", "kind: is 'speed'"),
        ("tradeoff.within=much", "tradeoff.within: is 'much'"),
        ("tradeoff.budget_ms=-1", "tradeoff.budget_ms: is -1"),
        ("studies=[sr]", "studies: names 'sr'"),
        ("studies=[lr]", "studies: names a part, but all records in docs/results/tradeoff would be replaced"),
        ("numerics.cases=[latent]", r"numerics.cases: names a part.*add results=FOLDER"),
        ("+curves.lr.curves.raw.colour=red", "has a key 'colour'"),
        ("+curves.lr.curves.raw.weights=lr_tiny", "names weights and network"),
        ("curves.lr.curves.raw.network=resnet", "has network 'resnet'"),
    ],
)
def test_unknown_names_and_limits_are_refused(tmp_path, monkeypatch, override, found) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=found):
        started(override)


@pytest.mark.parametrize(
    "scene", ["['scene=object','scene.seed=5000']", "['scene=harbour','scene.seed=0']", "['scene=captures/fox']"]
)
def test_no_choice_is_made_on_a_frozen_test_scene(tmp_path, monkeypatch, scene) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GAUSSIAN_ENHANCER_DATA", str(tmp_path))
    reported = configured(f"curves.lr.scenes.test.easy.object={scene}")
    with initialised():
        tradeoff.refuse_frozen_choices(reported, read_studies(reported))
    with pytest.raises(InputError, match="frozen test scene: nothing may be chosen by it"):
        started("kind=quality", f"curves.lr.scenes.validation.easy.object={scene}")
    assert not (tmp_path / "docs").exists()


def test_presets_are_not_chosen_by_records_of_a_frozen_test_scene(made) -> None:
    compared = read_studies(configured())
    assert tradeoff.choose_presets(compared, records_of(made))
    frozen = [replace(record, run="fox-3dgs-1a2b") for record in records_of(made)]
    with pytest.raises(InputError, match="nothing may be chosen by it"):
        tradeoff.choose_presets(compared, frozen)


def test_a_network_that_cannot_be_compiled_is_missing_and_one_that_can_says_how_long_it_took(
    tmp_path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(pipeline.fit, "run", plane_fit)
    one = "{weights: lr_tiny, compiled: true, settings: {once: {enhance: ['max_references=0']}}}"
    few = ("~curves.lr.scenes.test", "~curves.lr.scenes.validation.hard", "~curves.lr.curves.planned")
    compiled: list[object] = []
    monkeypatch.setattr(torch.nn.Module, "compile", lambda self: compiled.append(self))
    started("kind=quality", *few, f"+curves.lr.curves.compiled={one}")
    (record,) = [r for r in records_of(tmp_path) if "compiled" in r.variant]
    assert len(compiled) == 1
    assert record.metrics["compile_seconds"] >= 0

    def without_compiler(self):
        self._compiled_call_impl = failing

    def failing(*views):
        raise RuntimeError("no C++ compiler\nand so on")

    monkeypatch.setattr(torch.nn.Module, "compile", without_compiler)
    started("kind=quality", *few, f"+curves.lr.curves.compiled={one}")
    (record,) = [r for r in records_of(tmp_path) if "compiled" in r.variant]
    assert record.reasons["row"] == "is not compiled: RuntimeError: no C++ compiler"


def test_the_desk_curves_are_readable_and_name_what_the_issue_asks_for() -> None:
    with initialised():
        cfg = compose("tradeoff")
        studies = {study.name: study for study in read_studies(cfg)}
        lr = {one.name: one for one in studies["lr"].settings}
        assert {f"lr_tiny/{n} reference{'s' * (n != 1)}" for n in range(5)} <= set(lr)
        curves = {name.split("/")[0] for name in lr}
        assert {
            "raw",
            "GE",
            "GE++",
            "super SIF, paper's choices",
            "NAFNet",
            "EDVR",
            "SIF, ours",
            "lr_tiny compiled",
        } <= curves
        assert not {
            cell.scene for study in studies.values() for cell in study.cells if "seed=3000" in str(cell.fit)
        } & {cell.scene for study in studies.values() for cell in study.cells if "validation" in cell.scene}
        settings = [setting for study in studies.values() for setting in study.settings]
        for words in {setting.enhance for setting in settings}:
            compose("enhance", list(words))
        for words in {setting.train for setting in settings if setting.train}:
            compose("train", [*cfg.scale.trainings.usual.train, *words])


def test_only_settings_that_a_command_can_ask_for_are_offered() -> None:
    assert Setting("a/b", weights="lr_tiny").reproducible_by_enhance
    for odd in ({"compiled": True}, {"upscale": True}):
        assert not Setting("a/b", weights="lr_tiny", **odd).reproducible_by_enhance
    assert not Setting("a/b", network="identity").reproducible_by_enhance
