"""A training that was killed after its last step, or between an epoch and its validation, ends as one that was not."""

from pathlib import Path

import pytest
import torch

from gaussian_enhancer.cli.train import run
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.train.loggers import ResumableCSVLogger
from support.csv_log import logged_rows
from support.job_config import job_config

SMALL = ("fusion=sif", "fusion.widths=[8,8,8]", "fusion.blocks=[1,1,1]", "data.augmentation.crop=16")
SHORT = ("trainer=smoke", "logger=csv", "trainer.max_steps=6", "save_every=2", "data.steps_per_epoch=2")
QUIET = ("data.loading.batch_size=2", "runtime.threads=1", "runtime.progress=false")


@pytest.mark.parametrize("due", ["save_every=2", "save_every=5"])
def test_a_training_that_lost_its_last_files_makes_them_again(plane_run, other_plane_run, tmp_path, due: str) -> None:
    places = (f"data.train=[{plane_run}]", f"data.validation=[{other_plane_run}]", f"runs={tmp_path}")
    cfg = job_config("train", *SMALL, *SHORT, *QUIET, *places, due)
    run(cfg)
    (folder,) = tmp_path.glob("train/*")
    state, log = weights(folder), logged_rows(folder)
    checkpoint = torch.load(folder / "last.ckpt", weights_only=True)
    assert checkpoint["global_step"] < 6
    for name in ("done", "weights.safetensors", "card.json"):
        (folder / name).unlink()
    run(cfg)
    again = weights(folder)
    assert all(torch.equal(state[name], again[name]) for name in state)
    assert logged_rows(folder) == log


@pytest.mark.parametrize("written", range(1, 8))
def test_a_training_that_ended_between_a_checkpoint_and_its_log_goes_on_alike(
    plane_run, other_plane_run, tmp_path, monkeypatch, written: int
) -> None:
    def trained(folder: Path) -> Path:
        places = (f"data.train=[{plane_run}]", f"data.validation=[{other_plane_run}]", f"runs={folder}")
        run(job_config("train", *SMALL, *SHORT, *QUIET, *places, "data.steps_per_epoch=3"))
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
    assert logged_rows(again) == logged_rows(whole)
    state, other = weights(again), weights(whole)
    assert all(torch.equal(state[name], other[name]) for name in other)


def weights(folder: Path) -> dict[str, torch.Tensor]:
    return load_weights(folder / "weights.safetensors").network.state_dict()
