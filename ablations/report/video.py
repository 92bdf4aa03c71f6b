"""Makes the tables of docs/video.md from committed records."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ablations.scripts.flicker import compare_variants
from ablations.study.markdown import markdown
from ablations.study.row_table import read_layout, row_table
from ablations.study.rows import RowFile, frame_of
from gaussian_enhancer.metrics.records import Record

ONE_THREAD = "video_speed_one_thread.json"
"""Name of the records of speed with one thread, beside those with one thread per core."""
UNMEASURED = "Not measured yet: no record was made while the machine had nothing else to do.\n"
"""Text in place of the table of speed if there is no record."""


def read_speed(path: Path) -> pd.DataFrame:
    """Read the rows of the job ``video_speed``: with one thread per core, and with one thread, as far as measured.

    Args:
        path: the records with one thread per core.
    """
    files = [file for file in (path, path.with_name(ONE_THREAD)) if file.is_file()]
    rows = [RowFile(file, ("run", "threads"), option="run").read() for file in files]
    return pd.concat(rows) if rows else pd.DataFrame()


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
