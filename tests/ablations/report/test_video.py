"""The tables of docs/video.md are those of its records."""

import pytest

from ablations.report.video import PAGE, SPEED, UNMEASURED, fill_page, mark, speed_table
from ablations.study.rows import frame_of
from gaussian_enhancer.errors import InputError
from support.paths import DOCS, ROOT

MEASURED = {
    "milliseconds_a_frame": {"render": 20.0, "enhance": 100.4, "write": 5.0, "encode": 8.0, "together": 110.0},
    "one_after_the_other": 133.4,
    "slowest": "enhance",
    "share": 0.913,
    "run": "plane",
    "frames": 60,
    "size": "128x48",
    "rounds": 3,
    "threads": 1,
    "load_before": 0.25,
    "machine": "a machine",
    "commit": "0123456789",
}


def test_the_page_says_what_its_records_say() -> None:
    page = (ROOT / PAGE).read_text(encoding="utf-8")
    assert fill_page(page, DOCS / "results") == page


def test_a_row_for_each_number_of_threads_and_how_it_was_measured() -> None:
    measured = frame_of([MEASURED, {**MEASURED, "threads": 2, "share": 0.5}])
    head, _, first, second, _, told = speed_table(measured).splitlines()
    assert len(head.split("|")) == len(first.split("|"))
    assert first == "| 1 | 20 ms | 100 ms | 5 ms | 8 ms | 133 ms | 110 ms | enhance | 91% |"
    assert second.startswith("| 2 |")
    assert second.endswith("| 50% |")
    assert told == (
        "plane, 60 frames of 128x48, medians of 3 rounds; a machine, commit 0123456789; "
        "load of the machine before: 0.25 and 0.25."
    )


def test_a_page_without_marks_is_refused() -> None:
    assert speed_table(frame_of([])) == UNMEASURED
    with pytest.raises(InputError, match=r"docs/video\.md: has no place for its figures"):
        fill_page("no marks", DOCS / "results")
    with pytest.raises(InputError, match="has no place"):
        fill_page(f"{mark(SPEED[0])}\nno end", DOCS / "results")
