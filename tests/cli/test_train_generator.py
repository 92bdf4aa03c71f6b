"""The second stage's training from the command line's configuration to a simulator that uses its weights."""

import json
from pathlib import Path

import pytest
import torch

from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.generative.weights import load_model
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.runs.instantiate import build
from support.job_config import job_config

SMALL = ("+design.vector=4", "+design.grid=2", "+design.widths=[8,8]", "+design.code_width=8", "+design.code_blocks=1")
SHORT = ("paired.steps=3", "diffused.steps=2", "save_every=1", "data.loading.batch_size=2", "data.loading.workers=0")
QUIET = ("data.augmentation.crop=32", "runtime.threads=1", "runtime.progress=false", "trainer=smoke", "gate=random")


def configured(job: str, *options: str):
    return job_config(job, *options)


def settings(train: Path, validation: Path, runs: Path, *extra: str) -> list[str]:
    places = [f"runs={runs}", f"data.train=[{train}]", f"data.validation=[{validation}]"]
    return [*places, *SMALL, *SHORT, *QUIET, *extra]


@pytest.fixture(scope="module")
def trained(plane_run, other_plane_run, tmp_path_factory) -> Path:
    from gaussian_enhancer.cli.train_generator import run

    runs = tmp_path_factory.mktemp("trained")
    run(configured("train_generator", *settings(plane_run, other_plane_run, runs)))
    (folder,) = runs.glob("train_generator/*")
    return folder


def test_both_steps_are_trained_and_told_on_the_card(trained):
    card = json.loads((trained / "card.json").read_text())
    assert card["steps"] == {"paired": 3, "diffused": 2}
    assert {"gain/paired", "gain/diffused", "left/denoising"} <= set(card["validation"])
    assert card["gate"]["_target_"].endswith("RandomGate")
    assert load_model(trained / "weights.safetensors").model.design.widths == [8, 8]


def test_a_finished_training_is_found_again(trained, plane_run, other_plane_run, capsys):
    from gaussian_enhancer.cli.train_generator import run

    before = (trained / "weights.safetensors").read_bytes()
    run(configured("train_generator", *settings(plane_run, other_plane_run, trained.parents[1])))
    assert "trained already" in capsys.readouterr().err
    assert (trained / "weights.safetensors").read_bytes() == before


def test_a_second_step_that_was_lost_is_made_again_from_the_first(trained, plane_run, other_plane_run, tmp_path):
    """As after a kill between the steps: the first step's weights are found, not trained again."""
    from gaussian_enhancer.cli.train_generator import run

    options = settings(plane_run, other_plane_run, tmp_path)
    run(configured("train_generator", *options))
    (folder,) = tmp_path.glob("train_generator/*")
    paired = (folder / "paired.safetensors").stat().st_mtime_ns
    for name in ("done", "diffused.safetensors", "diffused.ckpt", "weights.safetensors"):
        (folder / name).unlink()
    run(configured("train_generator", *options))
    assert (folder / "paired.safetensors").stat().st_mtime_ns == paired
    torch.testing.assert_close(
        load_model(folder / "weights.safetensors").model.state_dict(),
        load_model(trained / "weights.safetensors").model.state_dict(),
        rtol=1e-3,
        atol=1e-4,
    )


def test_the_weights_simulate(trained):
    cfg = configured(
        "simulate", "image=unused.png", "generator=diffused", f"generator.weights={trained}/weights.safetensors"
    )
    simulator = Simulator(build(cfg.gate), build(cfg.generator))
    view = View(torch.rand(1, 3, 40, 56, generator=torch.Generator().manual_seed(0)))
    first, again, other = (simulator(view, torch.Generator().manual_seed(seed)).image for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
