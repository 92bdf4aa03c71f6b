"""The tables of docs/video.md are those of its records."""

import json
from pathlib import Path

from ablations.report.video import ONE_THREAD, UNMEASURED, read_speed, speed_table
from ablations.study.rows import frame_of

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


def test_records_of_one_thread_follow_those_of_all_and_may_be_missing(tmp_path: Path) -> None:
    path = tmp_path / "video_speed.json"
    assert speed_table(read_speed(path)) == UNMEASURED
    path.write_text(json.dumps({**MEASURED, "threads": 2}) + "\n")
    assert list(read_speed(path)["threads"]) == [2]
    (tmp_path / ONE_THREAD).write_text(json.dumps(MEASURED) + "\n")
    assert list(read_speed(path)["threads"]) == [2, 1]
