"""The jobs fit and enhance, run one after the other: from a scene to enhanced views.

Each step is the job that a user would start by hand, with the configuration from the job's own file. A finished fit or
enhancement is not repeated.
"""

from pathlib import Path

from omegaconf import DictConfig

from gaussian_enhancer.cli import enhance, fit
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs import status
from gaussian_enhancer.runs.earlier_step import resolve_earlier_step
from gaussian_enhancer.runs.enhancement import naming_configuration
from gaussian_enhancer.runs.run import Run, find_run


def fit_run(job: DictConfig, refusal: InputError | None = None) -> Run:
    """Return the finished run of a fit; compute it if it does not exist.

    Args:
        job: configuration of the job ``fit``.
        refusal: raised if the run does not exist and must not be computed; None computes it.

    Raises:
        InputError: the refusal, or an error of the job.
    """
    existing = find_run(job, "fit")
    if existing is not None and existing.done:
        return existing
    if refusal is not None:
        raise refusal
    with status.track_runs(discard=True):
        fit.run(job)
    return _finished_run(job, "fit")


def enhance_run(job: DictConfig) -> Path:
    """Enhance a run, unless a finished enhancement of the same configuration exists.

    Args:
        job: configuration of the job ``enhance``.

    Returns:
        The folder with renders, enhanced images and photos.

    Raises:
        InputError: the weights do not exist or cannot be used.
    """
    job = resolve_earlier_step(job)
    named = naming_configuration(job)
    existing = find_run(named, "enhance")
    if existing is None or not existing.done:
        enhance.run(job)
    return _finished_run(named, "enhance").folder


def _finished_run(job: DictConfig, name: str) -> Run:
    """The finished run of a job."""
    finished = find_run(job, name)
    if finished is None or not finished.done:
        raise RuntimeError(f"the job {name} left no finished run behind")
    return finished
