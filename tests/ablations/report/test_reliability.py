"""The page of reliability: what is counted, that failures are named, and that the committed page is its records'."""

from ablations.report.reliability import read_page, reliability_page
from ablations.stability.judge import FAILED, KIND, WITHIN
from gaussian_enhancer.metrics.records import Record
from support.paths import DOCS

FUZZ = [
    {"total": 7, "refused": 4, "right": 2, "crashed": 1},
    {"reader": "ply", "way": "cut", "verdict": "refused", "cases": 4},
    {"reader": "ply", "way": "flip", "verdict": "right", "cases": 2},
    {"reader": "spz", "way": "flip", "verdict": "crashed", "cases": 1},
    {"case": "spz/3", "reader": "spz", "seed": 3, "way": "a: flip", "verdict": "crashed", "detail": "KeyError: 'x'"},
]
COVERAGE = [
    {"reader": "ply", "file": "a", "seconds": 60, "inputs": 1200, "edges": 310, "verdict": "handled"},
    {"reader": "spz", "file": "a", "seconds": 60, "inputs": 50, "edges": 90, "verdict": "failed", "detail": "OOM"},
]
KILLS = [
    {"total": 4, "handled": 3, "failed": 1},
    {"case": "kill 0", "class": "kill", "job": "fit", "signal": "SIGKILL", "moment": "write 3 of 9",
     "verdict": "handled"},
    {"case": "kill 1", "class": "kill", "job": "fit", "signal": "SIGKILL", "moment": "9% of the time",
     "verdict": "failed", "detail": "splat.ply differs"},
    {"case": "two", "class": "two processes", "job": "fit", "signal": "", "moment": "the same command",
     "how": "waited", "verdict": "handled"},
    {"case": "full", "class": "full disk", "job": "fit", "signal": "disk full", "moment": "splat.ply",
     "verdict": "handled"},
]  # fmt: skip


def cell(name: str, outcome: str) -> Record:
    metrics: dict[str, float | None] = {"error": 0.0}
    return Record(KIND, "splats", name, "float32", "forward", outcome, metrics, {"outcome": "NaN"}, machine="a machine")


def test_cases_are_counted_by_class_and_failures_are_named() -> None:
    page = reliability_page(FUZZ, COVERAGE, KILLS, [cell("fine", WITHIN), cell("bad", FAILED)])
    for line in (
        "| damaged files | 7 | 6 | 1 |",
        "| inputs guided by coverage | 1,250 | 1,249 | 1 |",
        "| kills | 2 | 1 | 1 |",
        "| two processes on one folder | 1 | 1 | 0 |",
        "| full disk | 1 | 1 | 0 |",
        "| extreme numbers | 2 | 1 | 1 |",
        "| `ply` | 4 | 2 | 0 | 0 |",
        "| `fit` | SIGKILL | 1 | 1 | 1 | 1 |",
        "| `fit` | the same command | waited | handled |",
        "| `fit` | 1 | 1 | 0 | `splat.ply` |",
        "- spz/3: crashed; KeyError: 'x'",
        "- fit, kill, SIGKILL, 9% of the time: failed; splat.ply differs",
        "- bad float32 forward: failed; NaN",
    ):
        assert line in page


def test_where_nothing_has_failed_the_page_says_so() -> None:
    page = reliability_page(FUZZ[1:3], COVERAGE[:1], KILLS[1:2], [cell("fine", WITHIN)])
    assert "## What has failed\n\nNothing." in page
    assert "| full disk | not run yet |  |  |" in page


def test_the_committed_page_is_what_its_records_say() -> None:
    assert (DOCS / "reliability.md").read_text(encoding="utf-8") == read_page(DOCS / "results")
