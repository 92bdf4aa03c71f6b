"""Configurations of jobs, composed as the command line composes them, and jobs that run from them."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TypeVar

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from support.paths import CONF

Result = TypeVar("Result")
QUIET = ("runtime.progress=false", "runtime.threads=1", "runtime.device=cpu")
"""Options of a job in a test."""


def initialised() -> AbstractContextManager[object]:
    """The time in which jobs compose those of others."""
    return initialize_config_dir(str(CONF), version_base="1.3")


def job_config(job: str, *words: str) -> DictConfig:
    """The configuration of a job."""
    with initialised():
        return compose(job, list(words))


def run_job(run: Callable[[DictConfig], Result], cfg: DictConfig) -> Result:
    """Run a job that composes others."""
    with initialised():
        return run(cfg)
