"""What the coverage-guided campaign makes of libFuzzer's words; `nox -s fuzz -- --coverage` runs it."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from fuzz import coverage_guided
from fuzz.coverage_guided import outcome

WELL = "#2048\tpulse  cov: 311 ft: 420\nDone 5120 runs in 61 second(s)\nstat::number_of_executed_units: 5120\n"
BADLY = """\
#512\tpulse  cov: 99 ft: 120
 === Uncaught Python exception: ===
OverflowError: cannot fit 'int' into an index-sized integer
==7== ERROR: libFuzzer: fuzz target exited
stat::number_of_executed_units: 777
"""


def test_a_reader_that_holds_is_handled() -> None:
    assert outcome(0, WELL) == {"inputs": 5120, "edges": 311, "verdict": "handled"}


def test_a_reader_that_breaks_has_failed_and_says_how() -> None:
    found = outcome(77, BADLY)
    assert (found["verdict"], found["inputs"], found["edges"]) == ("failed", 777, 99)
    assert "OverflowError: cannot fit" in found["detail"]


def test_a_fuzzer_that_never_began_has_failed() -> None:
    assert outcome(0, "")["verdict"] == "failed"
    assert "ended with 1" in outcome(1, "")["detail"]


def test_every_row_states_its_commit(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    readers = SimpleNamespace(READERS={"camera_path": SimpleNamespace(files=["camera_path.json"])})
    ended = subprocess.CompletedProcess([], 0, "", WELL)
    monkeypatch.setitem(sys.modules, "fuzz.readers", readers)
    monkeypatch.setattr(coverage_guided.subprocess, "run", lambda *_, **__: ended)
    monkeypatch.setattr("gaussian_enhancer.metrics.provenance.provenance", lambda timed: {"commit": "0123456789"})
    rows = coverage_guided.run(["camera_path"], 1, tmp_path)
    assert [(row["commit"], row["verdict"]) for row in rows] == [("0123456789", "handled")]
