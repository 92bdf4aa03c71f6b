"""The way from a scene to records, walked by the jobs themselves: fit, enhance, measure.

Each step is the job that a user would start by hand, with a configuration composed from its own file; each finds its
run again where it was done before.
"""

from pathlib import Path

from omegaconf import DictConfig, open_dict

from gaussian_enhancer.checkpoint import checkpoint_digest, find_checkpoint
from gaussian_enhancer.cli import enhance, fit
from gaussian_enhancer.cli.measure import write_measurement
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.runs import status as status
from gaussian_enhancer.runs.run import Run, find_run


def finished_fit(job: DictConfig, refusal: InputError | None = None) -> Run:
    """A finished fit, made now where it is missing.

    Args:
        job: configuration of the job ``fit``.
        refusal: what is raised where it is missing and shall not be made; None to make it.

    Raises:
        InputError: the refusal, or that of the job.
    """
    found = find_run(job, "fit")
    if found is not None and found.done:
        return found
    if refusal is not None:
        raise refusal
    with status.attempt():
        fit.run(job)
    return _made(job, "fit")


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
    own = enhance.with_effect(job)
    before = find_run(own, "enhance")
    if before is None or not before.done:
        enhance.run(job)
    return _made(own, "enhance").folder


def measured(job: DictConfig, fit_folder: Path) -> tuple[tuple[Record, ...], Path]:
    """Measure an enhanced run under the names of its scene and its splat; the records and their folder.

    Args:
        job: configuration of the job ``measure``.
        fit_folder: the fit's folder, called scene-method-digest.
    """
    job.scene_name, job.splat_name, _ = fit_folder.name.rsplit("-", 2)
    return write_measurement(job)


def _made(job: DictConfig, name: str) -> Run:
    """The run that a job has just made."""
    found = find_run(job, name)
    if found is None or not found.done:
        raise RuntimeError(f"the job {name} left no finished run behind")
    return found
