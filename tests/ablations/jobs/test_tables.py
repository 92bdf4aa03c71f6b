"""The job ``tables`` on tiny worlds, fitted and trained in earnest: resumption, shared runs, gaps, damage."""

import csv
import json
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from ablations.suite import costs
from ablations.suite import method_runs as methods
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool, read_target
from gaussian_enhancer.cli import pipeline
from gaussian_enhancer.cli.train import naming_configuration
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.metrics.lpips import backbone_place
from gaussian_enhancer.metrics.records import read_records
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.runs.run import open_run
from support.stand_in_backbone import write_vgg
from support.tiny_suite import TINY, content, plan, started

OURS = ("ge", "ge_tsds", "ge_ssif", "gepp")
LEARNING = {*OURS, *(f"paper_{name}" for name in OURS)}
"""Methods of table 10 that are trained."""


def killed(folder: Path, begun: int, wait: float) -> None:
    """Start the job and kill it a little after so many runs were begun in all."""
    command = [sys.executable, "-c", "from gaussian_enhancer.cli.main import main; main()", "tables", "table=10"]
    process = subprocess.Popen([*command, *TINY], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and len(list(folder.glob("runs/*/*/config.yaml"))) < begun:
        time.sleep(0.01)
    time.sleep(wait)
    process.send_signal(signal.SIGKILL)
    assert process.wait() in (-signal.SIGKILL, 0)


@pytest.mark.slow
def test_a_sweep_that_is_killed_again_and_again_gives_the_tables_of_one_that_is_not(
    made, tmp_path, monkeypatch
) -> None:
    generator = random.Random(5)
    for begun in sorted(generator.sample(range(2, 12), 3)):
        killed(tmp_path, begun, generator.uniform(0, 0.4))
    monkeypatch.chdir(tmp_path)
    started("table=10")
    assert content(tmp_path) == content(made)
    for name in ("table_10.json", "table_10.csv"):
        assert (tmp_path / "results/tiny" / name).read_bytes() == (made / "results/tiny" / name).read_bytes()


def test_every_row_seed_and_view_is_there_with_its_sources(made) -> None:
    found = content(made)
    assert {entry[3] for entry in found} == {"raw", *LEARNING}
    assert len(found) == (1 + len(LEARNING)) * len({entry[2] for entry in found})
    for _, _, _, method, seed, metrics, sources, _ in found:
        assert metrics["psnr"] is not None
        assert seed == (None if method == "raw" else 0)
        for job, name in sources.items():
            assert (made / "runs" / job / name / "done").is_file()
        assert set(sources) == ({"fit"} if method == "raw" else {"fit", "train", "enhance"})


def test_what_was_made_is_not_made_again(copied, monkeypatch) -> None:
    before = content(copied)

    def refused(*_: object) -> None:
        raise AssertionError("computed again")

    for module, name in (
        (pipeline.fit, "run"),
        (methods.train, "run"),
        (methods, "method_images"),
        (methods, "measure_now"),
    ):
        monkeypatch.setattr(module, name, refused)
    (copied / "results/tiny/table_10.jsonl").unlink()
    started("table=10")
    assert content(copied) == before


def test_a_cell_without_backbone_names_file_and_folder_and_has_a_value_once_the_file_is_there(
    copied, tmp_path, monkeypatch
) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "empty"))
    monkeypatch.setenv("GAUSSIAN_ENHANCER_DATA", str(tmp_path / "data"))

    def values() -> dict[str, str]:
        started("table=10", "scale.lpips=[lpips_vgg_raw]")
        lines = csv.DictReader((copied / "results/tiny/table_10.csv").open())
        return {line["method"]: line["value"] for line in lines if line["metric"] == "lpips_vgg_raw"}

    assert set(values().values()) == {""}
    page = copied / "results/tiny/table_10.md"
    assert backbone_place("lpips_vgg_raw") in page.read_text()
    write_vgg(tmp_path / "data/lpips/vgg16_features.pth")
    measured = values()
    assert set(measured) == {"raw", *LEARNING}
    assert all(float(value) > 0 for value in measured.values())
    assert "no backbone; put torchvision's vgg16" not in page.read_text()


def test_equal_runs_of_different_tables_are_one(made, monkeypatch) -> None:
    monkeypatch.chdir(made)
    steps = plan("table=[10,2]")
    names = [(step.work.job, step.name) for step in steps]
    assert len(set(names)) == len(names)
    shared = {step.name.rsplit("-", 1)[0] for step in steps if step.tables == ("table_10", "table_2")}
    assert {"object_0-2dgs", "ge", "gepp_lr", "object-2dgs-raw", "object-2dgs-ge", "object-2dgs-gepp"} <= shared


def test_every_seed_has_a_simulator_of_its_own_that_its_trainings_learn_from(made, monkeypatch) -> None:
    (simulator,) = made.glob("runs/train_generator/*/done")
    name = simulator.parent.name
    learnt = {
        folder.parent.name.rsplit("-", 1)[0]: OmegaConf.load(folder).generator.get("weights")
        for folder in made.glob("runs/train/*/config.yaml")
    }
    assert {method for method, weights in learnt.items() if weights} == {
        *("ge_tsds", "gepp_lr", "paper_ge_tsds", "paper_gepp_lr")
    }
    assert {weights for weights in learnt.values() if weights} == {name}
    monkeypatch.chdir(made)
    steps = plan("table=7", "scale.seeds=[0,1]")
    own = [step for step in steps if step.work.job == "train_generator"]
    assert [(step.work.seed, step.state.name) for step in own] == [(0, "done"), (1, "not started")]
    for step in (one for one in steps if one.work.job == "train"):
        assert own[step.work.seed or 0].name in step.inputs
        assert own[1 - (step.work.seed or 0)].name not in step.inputs
    shipped = plan("table=7", "scale.simulator=null")
    assert not any(step.work.job == "train_generator" for step in shipped)
    assert not {one.digest for one in shipped if one.work.job == "train"} & {one.digest for one in steps}


def test_a_dry_run_writes_and_computes_nothing_and_knows_what_is_done(tmp_path, made, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    started("table=10", "dry_run=true")
    told = capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []
    assert "21 runs: 21 ready" in told
    assert "nothing is missing" in told
    assert "cell   table_10, Mip-NeRF 360, 2dgs: ready; 21 runs to make; about " in told
    assert "about 0 minutes" not in told
    monkeypatch.chdir(made)
    before = {path: path.stat().st_mtime_ns for path in made.rglob("*")}
    assert {step.state.name for step in plan("table=10")} == {"done"}
    assert {path: path.stat().st_mtime_ns for path in made.rglob("*")} == before


def test_a_dry_run_tells_what_is_missing(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert any("scene/gone" in step.missing for step in plan("table=10", "scale.fit=['scene=gone']"))
    elsewhere = "scale.datasets.mip_nerf_360.scenes.object"
    bare = ("scale.fit=[]", "scale.sparse=[]")
    for chosen, wanted in (
        ("scene=capture,scene.path=absent", "absent does not exist; put the capture there"),
        ("scene=datasets/room,scene.path=room", "room/images_2 does not exist; fetch it (gaussian-enhancer download"),
        ("scene=datasets/room,scene.path=room,scene.downscale=3", "choose from 1, 2, 4, 8"),
    ):
        words = chosen.split(",")
        steps = plan("table=10", f"{elsewhere}={words}", *bare)
        assert [wanted in step.missing for step in steps if step.work.fit[:1] == (words[0],)] == [True]


def test_a_damaged_record_is_refused_by_name(copied) -> None:
    file = next(copied.glob("runs/row/object-2dgs-gepp-*/records.jsonl"))
    file.write_text(file.read_text().replace('"psnr": ', '"psnr": 1', 1))
    with pytest.raises(InputError, match=rf"row/{file.parent.name}/records.jsonl line 1: was changed or damaged"):
        started("table=10")


def test_a_damaged_table_is_refused_by_name(copied) -> None:
    file = copied / "results/tiny/table_10.jsonl"
    file.write_text(file.read_text().replace('"ssim": 0', '"ssim": 1', 1))
    with pytest.raises(InputError, match=r"table_10.jsonl line \d+: was changed or damaged"):
        started("table=10", "records_only=true")


def test_reports_can_be_written_again_from_description_and_records_alone(copied) -> None:
    page = copied / "results/tiny/table_10.md"
    before = page.read_text()
    page.unlink()
    shutil.rmtree(copied / "runs")
    started("table=10", "records_only=true")
    assert page.read_text() == before
    assert "[table_10](table_10.md)" in (copied / "results/tiny/README.md").read_text()


def test_a_cell_that_cannot_be_made_leaves_its_reason(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    started("table=10", "fit_missing=false")
    found = read_records("results/tiny/table_10.jsonl")
    assert {(r.kind, r.variant) for r in found} == {("missing", method) for method in ("raw", *LEARNING)}
    assert all("is not made yet; gaussian-enhancer fit scene=object scene.seed=0" in r.reasons["row"] for r in found)
    assert not list(tmp_path.glob("runs/fit/*"))


def test_a_training_that_fails_is_missing_once_and_marked(copied, monkeypatch) -> None:
    tried = []

    def failing(job) -> None:
        tried.append(job)
        open_run(naming_configuration(job), "train", job.label)
        raise RuntimeError("out of memory")

    monkeypatch.setattr(methods.train, "run", failing)
    started("table=10", "scale.seeds=[7]")
    found = read_records("results/tiny/table_10.jsonl")
    assert {r.variant for r in found if r.kind == "missing"} == LEARNING
    assert {r.reasons["row"] for r in found if r.kind == "missing"} == {"RuntimeError: out of memory"}
    assert len(tried) == len(LEARNING)
    states = {step.name: step.state for step in plan("table=10", "scale.seeds=[7]") if step.work.job == "train"}
    assert {(state.name, state.detail) for state in states.values()} == {("failed", "RuntimeError: out of memory")}


@pytest.mark.parametrize("asked", ["11", "table_0", "[2,gate]", "[]"])
def test_unknown_tables_are_refused(asked, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="table"):
        started(f"table={asked}")
    assert list(tmp_path.iterdir()) == []


def test_costs_are_measured_at_the_size_of_the_output(tmp_path) -> None:
    weights = tmp_path / "w.safetensors"
    save_weights(weights, SIF((8, 8), (1, 1)), ReferenceConfig(), {})
    runtime = {"device": "cpu", "threads": 1, "keep_memory": False}
    runs = methods.Runs(OmegaConf.create({"scale": {"repeats": 2}, "runtime": runtime}))
    (found,) = costs._timed(runs, {"ge": str(weights)}, "1k", (32, 48), "name")
    assert found.size == (48, 32)
    assert found.metrics["milliseconds"] > 0
    assert found.metrics["peak_memory_mb"] > 10
    assert found.protocol.startswith("CPU, ")


def test_references_of_the_timed_plane_show_its_target() -> None:
    """They are warped onto it by depth and cameras, so that the time is that of a view as it comes."""
    seen = costs.plane(48, 64)
    target = read_target(seen.targets[0])
    aligned = ReferenceConfig().align(target, seen.targets[0], ReferencePool(seen.references))
    visible = aligned.visibility > 0.9
    assert visible.float().mean() > 0.7
    off = (aligned.references - target.image).abs().mean(1, keepdim=True)[visible]
    assert torch.median(off) < 0.02


def test_the_description_beside_the_records_is_that_of_the_scale(made) -> None:
    described = json.loads((made / "results/tiny/table_10.json").read_text())
    assert described["scale"] == "tiny"
    assert described["datasets"]["mip_nerf_360"]["stand_in"] == "a tiny object"
    assert described["paper"]["2dgs"]["paper_gepp"] == [28.42, 0.879, 0.202]
    assert "+ablation/variant=ge" in described["methods"]["ge"]["train"]
