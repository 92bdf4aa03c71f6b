"""A training that was killed after its last step, or between an epoch and its validation, ends as one that was not."""

import csv
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir

from gaussian_enhancer.cli.train import run
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.train.loggers import ResumableCSVLogger
from support.paths import CONF

SMALL = ("fusion=sif", "fusion.widths=[8,8,8]", "fusion.blocks=[1,1,1]", "data.augmentation.crop=16")
SHORT = ("trainer=smoke", "logger=csv", "trainer.max_steps=6", "save_every=2", "data.steps_per_epoch=2")
QUIET = ("data.loading.batch_size=2", "runtime.threads=1", "runtime.progress=false")


@pytest.mark.parametrize("due", ["save_every=2", "save_every=5"])
def test_a_training_that_lost_its_last_files_makes_them_again(plane_run, other_plane_run, tmp_path, due: str) -> None:
    places = (f"data.train=[{plane_run}]", f"data.validation=[{other_plane_run}]", f"runs={tmp_path}")
    with initialize_config_dir(CONF, version_base="1.3"):
        cfg = compose("train", [*SMALL, *SHORT, *QUIET, *places, due])
    run(cfg)
    (folder,) = tmp_path.glob("train/*")
    state, log = weights(folder), rows(folder)
    checkpoint = torch.load(folder / "last.ckpt", weights_only=True)
    assert checkpoint["global_step"] < 6
    for name in ("done", "weights.safetensors", "card.json"):
        (folder / name).unlink()
    run(cfg)
    again = weights(folder)
    assert all(torch.equal(state[name], again[name]) for name in state)
    assert rows(folder) == log


@pytest.mark.parametrize("written", range(1, 8))
def test_a_training_that_ended_between_a_checkpoint_and_its_log_goes_on_alike(
    plane_run, other_plane_run, tmp_path, monkeypatch, written: int
) -> None:
    def trained(folder: Path) -> Path:
        places = (f"data.train=[{plane_run}]", f"data.validation=[{other_plane_run}]", f"runs={folder}")
        with initialize_config_dir(CONF, version_base="1.3"):
            run(compose("train", [*SMALL, *SHORT, *QUIET, *places, "data.steps_per_epoch=3"]))
        return next(folder.glob("train/*"))

    whole = trained(tmp_path / "whole")
    left = [written]
    save = ResumableCSVLogger.save

    def no_room(logger: ResumableCSVLogger) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise InputError("disk", "is full", "free some space")
        save(logger)

    with monkeypatch.context() as patch:
        patch.setattr(ResumableCSVLogger, "save", no_room)
        with pytest.raises(InputError, match="is full"):
            trained(tmp_path / "cut")
    again = trained(tmp_path / "cut")
    assert rows(again) == rows(whole)
    state, other = weights(again), weights(whole)
    assert all(torch.equal(state[name], other[name]) for name in other)


def weights(folder: Path) -> dict[str, torch.Tensor]:
    return load_weights(folder / "weights.safetensors").network.state_dict()


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "log/metrics.csv").open(newline="") as file:
        return list(csv.DictReader(file))
