"""The dashboard's studies beside the tables: error over run time, stability, and what plans leave out."""

import html
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from ablations.report.plan_study import PlanAims, PlanScenes, cost_table
from ablations.report.stability import count_table
from ablations.report.tradeoff_quality import group_by_side, setting_table
from ablations.stability.judge import KIND as CELL
from ablations.tradeoff.summary import summarise
from gaussian_enhancer.files import atomic_write
from gaussian_enhancer.metrics.records import Record, read_records

FOLDER = "diagrams"
NOTES = {
    "tradeoff": (
        "gaussian-enhancer tradeoff",
        "Error over run time, both logarithmic; the grey line is the Pareto front, whose settings are named.",
    ),
    "stability": (
        "gaussian-enhancer stability",
        "Every case in five precisions, forward and backward, compared with float64.",
    ),
    "plan": (
        "gaussian-enhancer plan_study",
        "What a plan leaves out of each scene: the time that this saves, and what it costs.",
    ),
}
"""By study: the job that measures it, and how to read it."""


@dataclass(frozen=True)
class StudyView:
    """The content of the page on one study.

    Args:
        name: the part of the page that shows it.
        note: how to read it.
        diagrams: title of each SVG document, unescaped, and its file's address relative to the page.
        tables: by heading.
        absent: why there is nothing to show; empty otherwise.
    """

    name: str
    note: str
    diagrams: tuple[dict[str, str], ...] = ()
    tables: Mapping[str, pd.DataFrame] | None = None
    absent: str = ""

    def to_plain_values(self) -> dict[str, Any]:
        """The study as plain values for the page's script."""
        tables = [
            {"title": title, "columns": list(table.columns), "rows": table.to_numpy().tolist()}
            for title, table in (self.tables or {}).items()
        ]
        return {**vars(self), "tables": tables}


def read_study(name: str, records: Path, diagrams: Path, output: Path, aims: PlanAims) -> StudyView:
    """Read a study for the page; its ``absent`` states the reason if nothing was measured.

    Args:
        name: one of `NOTES`.
        records: the file of records of the study's job.
        diagrams: an SVG file, or a folder of SVG files.
        output: the page's folder, to which diagrams are copied.
        aims: aims of the plans.

    Raises:
        InputError: records are damaged, or a file cannot be written.
    """
    if not records.is_file():
        return StudyView(name, "", absent=f"Nothing was measured where this page was made: {NOTES[name][0]}.")
    study_records = read_records(records)
    tables = {
        "tradeoff": _tradeoff_tables,
        "stability": _stability_tables,
        "plan": lambda plan_records: _plan_tables(plan_records, aims),
    }[name](study_records)
    files = sorted(diagrams.glob("*.svg")) if diagrams.is_dir() else [diagrams] if diagrams.is_file() else []
    return StudyView(name, NOTES[name][1], copy_diagrams(files, output), tables)


def _tradeoff_tables(records: Sequence[Record]) -> dict[str, pd.DataFrame]:
    return {
        f"{study}, {side} scenes": setting_table(summarise(side_records)[0])
        for (study, side), side_records in group_by_side(records).items()
    }


def _stability_tables(records: Sequence[Record]) -> dict[str, pd.DataFrame]:
    families: dict[str, list[Record]] = {}
    for record in records:
        if record.kind == CELL:
            families.setdefault(record.run, []).append(record)
    return {family.capitalize(): count_table(family_records) for family, family_records in families.items()}


def _plan_tables(records: Sequence[Record], aims: PlanAims) -> dict[str, pd.DataFrame]:
    scenes = PlanScenes("", "", records, aims)
    return {f"{plan} against {aims.baseline}": cost_table(scenes.costs(plan), aims) for plan in scenes.plans()}


def copy_diagrams(sources: Sequence[Path], output: Path) -> tuple[dict[str, str], ...]:
    """Copy SVG files beside the page; returns `StudyView.diagrams`.

    Args:
        sources: files written by jobs; of two with the same name the last is shown.
        output: the page's folder.

    Raises:
        InputError: a file cannot be written.
    """
    diagrams = []
    for path in sources:
        with atomic_write(output / FOLDER / path.name) as temporary:
            shutil.copyfile(path, temporary)
        diagrams.append({"title": _title(path), "file": f"{FOLDER}/{path.name}"})
    return tuple(diagrams)


def _title(path: Path) -> str:
    """The title of an SVG document, else its file's name."""
    match = re.search(r"<svg[^>]*>\s*<title>(.*?)</title>", path.read_text(encoding="utf-8"), re.S)
    return html.unescape(match[1]) if match else path.stem.replace("_", " ")
