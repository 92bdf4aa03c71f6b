"""Writes the dashboard's page: one file that contains all numbers and the script; pictures are in folders beside it."""

from collections.abc import Sequence
from datetime import UTC, datetime

from ablations.report.dashboard.folder import TableRecords, all_records
from ablations.report.dashboard.packed import packed_tables
from ablations.report.dashboard.pictures import ShownImages
from ablations.report.dashboard.runs import SourceRun, packed_runs
from ablations.report.dashboard.studies import StudyView
from gaussian_enhancer.metrics.provenance import this_commit
from gaussian_enhancer.metrics.records import MISSING
from gaussian_enhancer.report.templating import render

SCRIPTS = (
    "elements",
    "records",
    "grid",
    "provenance",
    "tables",
    "curves",
    "distributions",
    "pictures",
    "settings",
    "measurements",
    "studies",
    "tabs",
)
"""The parts of the page's script, in order; each is one file in ``report/templates/dashboard``."""

PACKAGE = "ablations.report"

POLICY = "img-src data: file: 'self'; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
"""Content security policy: style and script are inside the page, pictures in folders beside it."""


def document(
    title: str,
    tables: Sequence[TableRecords],
    runs: Sequence[SourceRun] = (),
    pictures: ShownImages | None = None,
    studies: Sequence[StudyView] = (),
) -> str:
    """The page's HTML.

    Args:
        title: the page's title.
        tables: tables and their records.
        runs: the runs that the records name.
        pictures: pictures that were copied beside the page.
        studies: further studies, whose diagrams were copied beside the page.
    """
    data = {**packed_tables(tables), **packed_runs(runs), **(pictures or ShownImages()).packed()}
    data["studies"] = [study.to_plain_values() for study in studies]
    records = all_records(tables)
    missing = sum(record.kind == MISSING for record in records)
    missing_note = f" · {missing} of them of what is missing" if missing else ""
    values = {
        "title": title,
        "subtitle": f"{_counted(len(tables), 'table')} · {_counted(len(records), 'record')}{missing_note}",
        "data": data,
        "package": PACKAGE,
        "policy": POLICY,
        "scripts": [f"dashboard/{name}.js" for name in SCRIPTS],
        "written": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": this_commit(),
    }
    return render("dashboard/dashboard.html", values, PACKAGE)


def _counted(count: int, word: str) -> str:
    return f"{count:,} {word}{'' if count == 1 else 's'}"
