"""Multiruns through each launcher: every job a finished run, equal jobs trained once."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from hydra import compose

from support.job_config import initialised

SMALL = ("fusion=sif", "fusion.widths=[8,8,8]", "data.augmentation.crop=32", "data.loading.batch_size=2")
LAUNCHERS = {
    "joblib": ["+sweep=two_jobs"],
    "submitit": ["hydra/launcher=submitit_local", "runtime.progress=false", "runtime.threads=1"],
}


def swept(runs: Path, train: Path, validation: Path, *words: str) -> str:
    """What a multirun of the job train printed, its jobs' own prints included."""
    places = [f"data.train=[{train}]", f"data.validation=[{validation}]", f"runs={runs}", "logger=csv", "trainer=smoke"]
    program = "from gaussian_enhancer.cli.main import main; main()"
    command = [sys.executable, "-c", program, "train", "-m", *places, *SMALL, *words]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    process = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    jobs = [path.read_text() for path in runs.glob("multirun/.submitit/*/*_log.out")]
    return "\n".join([process.stdout, *jobs])


@pytest.mark.slow
@pytest.mark.parametrize("launcher", list(LAUNCHERS))
def test_every_job_is_a_finished_run_and_equal_jobs_are_done_once(launcher, plane_run, other_plane_run, tmp_path):
    output = swept(
        tmp_path, plane_run, other_plane_run, *LAUNCHERS[launcher], "seed=0,0,1"
    )  # the equal two start at once
    folders = sorted(tmp_path.glob("train/*"))
    assert sorted(json.loads((folder / "card.json").read_text())["seed"] for folder in folders) == [0, 1]
    assert all((folder / "done").is_file() for folder in folders)
    assert len(re.findall("trained already", output)) == 1, output


def test_a_cluster_gets_the_same_jobs():
    with initialised():
        cfg = compose("train", ["+sweep=slurm", "data.train=[]", "data.validation=[]"], return_hydra_config=True)
    assert cfg.hydra.launcher._target_.endswith("SlurmLauncher")
    assert cfg.hydra.launcher.gpus_per_node == 1
    assert cfg.runtime.progress is False


def test_a_search_by_optuna_composes_and_names_options_that_there_are():
    from hydra_plugins.hydra_optuna_sweeper._impl import create_params_from_overrides
    from omegaconf import OmegaConf

    with initialised():
        cfg = compose("train", ["+sweep=optuna", "data.train=[]", "data.validation=[]"], return_hydra_config=True)
    sweeper = cfg.hydra.sweeper
    assert sweeper._target_.endswith("OptunaSweeper")
    assert sweeper.sampler._target_.endswith("TPESampler")
    assert sweeper.direction == "maximize"
    ranges, fixed = create_params_from_overrides([f"{name}={value}" for name, value in sweeper.params.items()])
    assert set(ranges) == set(sweeper.params)
    assert not fixed
    assert all(OmegaConf.select(cfg, name) is not None for name in ranges)
    assert cfg.study == "lr"


@pytest.mark.slow
def test_a_search_by_optuna_trains_each_trial(plane_run, other_plane_run, tmp_path):
    output = swept(
        tmp_path, plane_run, other_plane_run, "+sweep=optuna", "hydra.sweeper.n_trials=2", "runtime.threads=1"
    )
    folders = list(tmp_path.glob("train/*"))
    assert len(folders) == 2
    assert all((folder / "done").is_file() for folder in folders)
    best = max(json.loads((folder / "card.json").read_text())["validation"]["gain/psnr"] for folder in folders)
    stated = (tmp_path / "multirun/optimization_results.yaml").read_text()
    assert float(re.search(r"best_value: (\S+)", stated)[1]) == pytest.approx(best, abs=1e-5), output
