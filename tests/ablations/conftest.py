import os
import shutil
from pathlib import Path

import pytest

from support.tiny_suite import started


@pytest.fixture(scope="session")
def made(tmp_path_factory) -> Path:
    """A folder in which table 10 was made without interruption, one run at a time; not to be written into."""
    folder, before = tmp_path_factory.mktemp("made"), Path.cwd()
    os.chdir(folder)
    try:
        started("table=10")
    finally:
        os.chdir(before)
    return folder


@pytest.fixture
def copied(made, tmp_path, monkeypatch) -> Path:
    """A copy of that folder, to be in and to write into."""
    shutil.copytree(made, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    return tmp_path / "copy"
