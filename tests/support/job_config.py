"""Configurations of jobs, composed as the command line composes them."""

from contextlib import AbstractContextManager

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from support import paths

QUIET = ("runtime.progress=false", "runtime.threads=1", "runtime.device=cpu")
"""Options of a job in a test."""


def initialised() -> AbstractContextManager[object]:
    """The time in which jobs compose those of others."""
    return initialize_config_dir(paths.CONF, version_base="1.3")


def job_config(job: str, *words: str) -> DictConfig:
    """The configuration of a job."""
    with initialised():
        return compose(job, list(words))
