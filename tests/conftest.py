from pathlib import Path

import pytest

from synthetic_runs import write_plane_run


@pytest.fixture(scope="session")
def plane_run(tmp_path_factory) -> Path:
    """A small fitted run with two snapshots and exact geometry; not to be written into."""
    return write_plane_run(tmp_path_factory.mktemp("runs") / "plane-0", steps=(50, 100))


@pytest.fixture(scope="session")
def other_plane_run(tmp_path_factory) -> Path:
    """Another one, to validate on."""
    return write_plane_run(tmp_path_factory.mktemp("runs") / "plane-1", seed=1)
