import os
from pathlib import Path

import pytest
import torch

from support.synthetic_runs import write_plane_run


def pytest_configure(config: pytest.Config) -> None:
    """Processes that run tests beside each other share the cores, and so do those that they start."""
    count = os.environ.get("PYTEST_XDIST_WORKER_COUNT")
    if count is not None:
        share = max(1, (os.cpu_count() or 1) // int(count))
        torch.set_num_threads(share)
        os.environ.setdefault("OMP_NUM_THREADS", str(share))
        os.environ.setdefault("NUMBA_NUM_THREADS", str(share))


@pytest.fixture(scope="session")
def plane_run(tmp_path_factory) -> Path:
    """A small fitted run with two snapshots and exact geometry; not to be written into."""
    return write_plane_run(tmp_path_factory.mktemp("runs") / "plane-0", steps=(50, 100))


@pytest.fixture(scope="session")
def other_plane_run(tmp_path_factory) -> Path:
    """Another one, to validate on."""
    return write_plane_run(tmp_path_factory.mktemp("runs") / "plane-1", seed=1)
