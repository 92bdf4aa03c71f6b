"""Makes the tables of docs/video.md from committed records, and inserts them between marks of the page."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ablations.report.readme import insert_between_marks
from ablations.scripts.flicker import compare_variants
from ablations.study.markdown import markdown
from ablations.study.row_table import read_layout, row_table
from ablations.study.rows import RowFile, frame_of
from gaussian_enhancer.metrics.records import Record, read_records

PAGE = Path("docs/video.md")
SPEED = ("video_speed.json", "video_speed_one_thread.json")
"""Records of speed in docs/results: with one thread per core, and with one thread."""
UNMEASURED = "Not measured yet: no record was made while the machine had nothing else to do.\n"
"""Text in place of the table of speed if there is no record."""
FLICKER = ("flicker_converged.jsonl", "flicker_path.jsonl")
"""Records of flicker in docs/results: on converged splats of real captures, and on procedural worlds."""


def mark(name: str) -> str:
    """The mark in the page after which a record's table is inserted.

    Args:
        name: of the record's file.
    """
    return f"<!-- docs/results/{name}: gaussian-enhancer pages write=true -->"


def speed_table(measured: pd.DataFrame) -> str:
    """Milliseconds per frame of each stage and of all together, and how they were measured.

    Args:
        measured: rows of the job ``video_speed``, one for each number of threads; without rows, the result is
            `UNMEASURED`.
    """
    if measured.empty:
        return UNMEASURED
    row = measured.iloc[0]
    loads = " and ".join(f"{load:g}" for load in measured["load_before"])
    description = f"{row['run']}, {row['frames']} frames of {row['size']}, medians of {row['rounds']} rounds; "
    description += f"{row['machine']}, commit {row['commit']}; load of the machine before: {loads}."
    return f"{markdown(row_table(measured, read_layout('video_speed')))}\n{description}\n"


def flicker_table(records: Sequence[Record]) -> str:
    """Flicker by choice of references and smoothing, as ratios to raw frames and exact photos, and the gain in PSNR.

    Args:
        records: of the job ``flicker``.
    """
    comparison = compare_variants(frame_of(records))
    return markdown(row_table(comparison[comparison["variant"] != "change"], read_layout("flicker_path")))


def fill_page(page: str, results: Path) -> str:
    """Insert the tables, made from records, into the page.

    Args:
        page: text of the page.
        results: the folder of committed records.

    Raises:
        InputError: the page has no marks, a record is damaged, or a record of flicker is missing.
    """
    files = [results / name for name in SPEED if (results / name).is_file()]
    rows = [RowFile(path, ("run", "threads"), option="run").read() for path in files]
    page = insert_between_marks(page, speed_table(pd.concat(rows) if rows else pd.DataFrame()), mark(SPEED[0]), PAGE)
    for name in FLICKER:
        page = insert_between_marks(page, flicker_table(read_records(results / name)), mark(name), PAGE)
    return page
