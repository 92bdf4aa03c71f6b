"""The tables of docs/video.md, made from committed records and put between marks of the page."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ablations.report.readme import inserted
from ablations.scripts.flicker import compared
from ablations.study.markdown import markdown
from ablations.study.row_table import read_layout, row_table
from ablations.study.rows import RowFile, frame_of
from gaussian_enhancer.metrics.records import Record, read_records

PAGE = Path("docs/video.md")
SPEED = ("video_speed.json", "video_speed_one_thread.json")
"""Records of the speed in docs/results: each stage with as many threads as there are cores, and with one."""
UNMEASURED = "Not measured yet: no record was made while the machine had nothing else to do.\n"
"""What stands in place of the table of the speed while there is no record."""
FLICKER = ("flicker_converged.jsonl", "flicker_path.jsonl")
"""Records of flicker there: on converged splats of real captures, and on procedural worlds."""


def mark(name: str) -> str:
    """The line of the page after which a record's table stands.

    Args:
        name: of the record's file.
    """
    return f"<!-- docs/results/{name}: gaussian-enhancer pages write=true -->"


def speed_table(measured: pd.DataFrame) -> str:
    """Milliseconds a frame of each stage by itself and of all together, and how they were measured.

    Args:
        measured: rows of the job ``video_speed``, one for each number of threads; where there is none, the table says
            so.
    """
    if measured.empty:
        return UNMEASURED
    first = measured.iloc[0]
    loads = " and ".join(f"{load:g}" for load in measured["load_before"])
    description = f"{first['run']}, {first['frames']} frames of {first['size']}, medians of {first['rounds']} rounds; "
    description += f"{first['machine']}, commit {first['commit']}; load of the machine before: {loads}."
    return f"{markdown(row_table(measured, read_layout('video_speed')))}\n{description}\n"


def flicker_table(records: Sequence[Record]) -> str:
    """Flicker by choice of references and smoothing, ratios to raw frames and exact photos, and the gain in PSNR.

    Args:
        records: of the job ``flicker``.
    """
    found = compared(frame_of(records))
    return markdown(row_table(found[found["variant"] != "change"], read_layout("flicker_path")))


def filled(page: str, results: Path) -> str:
    """The page with its tables as the records have them.

    Args:
        page: its text.
        results: the folder of committed records.

    Raises:
        InputError: the page has no marks, or a record is damaged, or that of flicker missing.
    """
    files = [results / name for name in SPEED if (results / name).is_file()]
    rows = [RowFile(path, ("run", "threads"), option="run").read() for path in files]
    page = inserted(page, speed_table(pd.concat(rows) if rows else pd.DataFrame()), mark(SPEED[0]), PAGE)
    for name in FLICKER:
        page = inserted(page, flicker_table(read_records(results / name)), mark(name), PAGE)
    return page
