"""The way from a scene to records, walked by the jobs themselves: fit, enhance, measure.

Each step is the job that a user would start by hand, with a configuration composed from its own file; each finds its
run again where it was done before.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, open_dict

from gaussian_enhancer.apps import enhance, fit
from gaussian_enhancer.apps.measure import write_measurement
from gaussian_enhancer.apps.run import Run, find_run
from gaussian_enhancer.checkpoint import checkpoint_digest, find_checkpoint
from gaussian_enhancer.measure.records import Record


def job_configuration(name: str, parent: DictConfig, overrides: Sequence[str] = (), **values: Any) -> DictConfig:
    """The configuration of another job, writing and computing where the calling job does.

    Args:
        name: the other job.
        parent: the calling job's configuration; ``runs`` and ``runtime`` are taken from it.
        overrides: as on the command line.
        **values: top-level values that a command line cannot hold.
    """
    from hydra import compose

    job = compose(name, overrides=list(overrides))
    with open_dict(job):
        for key, value in {"runs": parent.runs, "runtime": parent.runtime, **values}.items():
            job[key] = value
    return job


def made(job: DictConfig, name: str) -> Run:
    """The run that a job has just made."""
    found = find_run(job, name)
    if found is None:
        raise RuntimeError(f"the job {name} left no run behind")
    return found


def fitted(job: DictConfig) -> Path:
    """Fit a splat, or find it fitted; the run's folder.

    Args:
        job: configuration of the job ``fit``.
    """
    fit.run(job)
    return made(job, "fit").folder


def enhanced(job: DictConfig) -> Path:
    """Enhance a run, or find it enhanced; the folder with renders, enhanced images and photos side by side.

    What the weights hold is part of what determines the run, so that a file which was trained further is used anew.

    Args:
        job: configuration of the job ``enhance``.

    Raises:
        InputError: there are no such weights, or they cannot be used.
    """
    with open_dict(job):
        job.weights_digest = checkpoint_digest(find_checkpoint(job.weights))
    before = find_run(job, "enhance")
    if before is None or not before.done:
        enhance.run(job)
    return made(job, "enhance").folder


def measured(job: DictConfig, fit_folder: Path) -> tuple[tuple[Record, ...], Path]:
    """Measure an enhanced run under the names of its scene and its splat; the records and their folder.

    Args:
        job: configuration of the job ``measure``.
        fit_folder: the fit's folder, called scene-method-digest.
    """
    job.scene_name, job.splat_name, _ = fit_folder.name.rsplit("-", 2)
    return write_measurement(job)
