"""A session on the plane's run, whose splat is a sheet of coloured Gaussians, and a network that brightens."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from omegaconf import DictConfig

from gaussian_enhancer.viewer.session import Session
from gaussian_enhancer.viewer.source import open_session
from support.bright_weights import write_bright_weights
from support.job_config import QUIET, job_config
from support.synthetic_runs import coloured_sheet, copy_with_splat


@pytest.fixture(scope="session")
def viewed(sheet_run, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("viewed") / "plane"
    return copy_with_splat(sheet_run, folder, coloured_sheet(12), "distilled.ply")


@pytest.fixture(scope="session")
def bright(tmp_path_factory) -> Path:
    return write_bright_weights(tmp_path_factory.mktemp("weights"), 0.5)


@pytest.fixture(scope="session")
def configured(viewed, bright) -> Callable[..., DictConfig]:
    def composed(*overrides: str) -> DictConfig:
        words = [f"run={viewed}", f"weights={bright}", "colour_clamping=0", "precision=float32", *QUIET, *overrides]
        return job_config("view", *words)

    return composed


@pytest.fixture
def session(configured) -> Session:
    return open_session(configured(), torch.device("cpu"), print)
