import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock

from gaussian_enhancer.cli import main as cli
from support.tiny_suite import started


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """A folder in which table 10 was made without interruption, one run at a time; not to be written into.

    Processes that run tests beside each other share it.
    """
    own = tmp_path_factory.getbasetemp()
    folder = (own if worker_id == "master" else own.parent) / "made"
    with FileLock(f"{folder}.lock"):
        if not (folder / "results/tiny/README.md").is_file():
            folder.mkdir(exist_ok=True)
            make_table(folder)
    return folder


def make_table(folder: Path) -> None:
    """Make table 10 in a folder."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        started("table=10")
    finally:
        os.chdir(before)


@pytest.fixture
def copied(made, tmp_path, monkeypatch) -> Path:
    """A copy of that folder, to be in and to write into."""
    shutil.copytree(made, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    return tmp_path / "copy"


@pytest.fixture
def job(monkeypatch) -> Callable[..., None]:
    """Run a job as the command line does, on one thread."""
    monkeypatch.setattr(sys, "argv", ["gaussian-enhancer"])

    def run(name: str, *words: str) -> None:
        cli.main([name, "runtime.threads=1", *words])

    return run
