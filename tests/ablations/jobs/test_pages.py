"""Every committed page is what its records say, and one that is not is named."""

import shutil
from pathlib import Path

import pytest

from ablations.jobs.pages import DOCS, README, remade
from support.job_config import initialised
from support.paths import ROOT

CHANGED = DOCS / "results" / "distil.md"


@pytest.mark.slow
def test_the_one_page_that_was_changed_by_hand_differs_from_its_records(tmp_path: Path) -> None:
    source, made = tmp_path / "source", tmp_path / "made"
    shutil.copytree(ROOT / DOCS, source / DOCS)
    shutil.copyfile(ROOT / README, source / README)
    with (source / CHANGED).open("a", encoding="utf-8") as file:
        file.write("| a number that no record holds |\n")
    with initialised():
        assert remade(source, made) == [CHANGED]
    assert (made / CHANGED).read_bytes() == (ROOT / CHANGED).read_bytes()
