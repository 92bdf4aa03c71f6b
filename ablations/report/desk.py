"""Makes the tables of docs/results/desk.md from the records of the suite at desk scale."""

import math
from pathlib import Path

import pandas as pd

from ablations.study.description import read_description
from ablations.study.markdown import markdown
from ablations.study.row_table import read_layout, row_table
from ablations.study.rows import frame_of, with_gains
from gaussian_enhancer.metrics.records import MISSING, read_records

STAND_INS = {
    "table_2": "unbounded ([table 2](tables/desk/table_2.md))",
    "table_5": "indoor ([table 5](tables/desk/table_5.md))",
    "table_6": "object ([table 6](tables/desk/table_6.md))",
    "table_4": "outdoor ([table 4](tables/desk/table_4.md))",
    "captures": "real captures ([captures](tables/desk/captures.md))",
}
"""Rows of the table of stand-ins, by the table whose records they summarise."""
FIRST_SEED = 0


def stand_in_table(folder: Path) -> str:
    """PSNR of the raw renders of each stand-in, and the gains of GE and GE++, the paper's and ours.

    Args:
        folder: with the records of the tables.
    """
    rows = pd.concat([_run_means(folder / f"{table}.jsonl").assign(data=title) for table, title in STAND_INS.items()])
    return markdown(row_table(rows, read_layout("desk_stand_ins")))


def choices_table(path: Path) -> str:
    """Gains of our networks with one choice of the paper each: our own choices first, the others by their gain.

    Args:
        path: records of the study ``mode``, beside its description.
    """
    methods = read_description(path.with_suffix(".json")).methods
    views = _views(path)
    views = views[views["variant"] != "raw"]
    views = views.assign(about=[methods[name].about for name in views["variant"]])
    order = views.groupby("variant")["gain psnr"].transform("mean").mask(views["variant"] == "ours", -math.inf)
    return markdown(row_table(views.assign(order=order).sort_values("order"), read_layout("desk_choices")))


def _views(path: Path) -> pd.DataFrame:
    """The measured views of a table with their gains over the raw render."""
    return with_gains(
        frame_of(record for record in read_records(path) if record.kind != MISSING), {"variant": "raw"}, ("run", "view")
    )


def _run_means(path: Path) -> pd.DataFrame:
    """One row per fit: the mean PSNR of its raw renders, and the mean gain of every method with the first seed."""
    views = _views(path)
    views = views[views["seed"].isna() | (views["seed"] == FIRST_SEED)]
    means = views.groupby(["run", "variant"])[["psnr", "gain psnr"]].mean().unstack()
    return means["gain psnr"].assign(raw=means["psnr"]["raw"])
