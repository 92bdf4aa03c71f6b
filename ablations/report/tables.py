"""Reports of a table from its description and records alone: Markdown, LaTeX, and one line a cell as CSV."""

import csv
import io
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from ablations.records.description import Table
from ablations.records.results import Results
from ablations.report import latex
from ablations.report.caption import caption, reading, sources, stated
from ablations.report.claims import Claim, claims
from ablations.report.rendered_cells import Piece, Sheet
from ablations.report.rendered_table import Figures
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.comparison import Table as PlainTable
from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER, MISSING, Record

CELL = (
    *("table", "scale", "block", "dataset", "row", "title", "statistic", "metric", "better", "value", "gain", "low"),
    *("high", "sd_over_seeds", "p", "p_holm", "test_units", "test_unit", "paper", "paper_gain", "scenes", "seeds"),
    *("views", "best", "paper_best", "missing"),
)
"""Columns of the CSV."""


def write_reports(folder: Path, table: Table, records: Sequence[Record]) -> list[Path]:
    """Write ``<folder>/<name>.md``, ``.tex`` and ``.csv``, each whole or not at all.

    Args:
        folder: where description and records lie; a grid of images as ``<name>.png`` is shown where there is one.
        table: its description.
        records: its records, in any order.

    Returns:
        The files.

    Raises:
        InputError: a view was measured twice, or a file cannot be written.
    """
    figures = Figures(table, records)
    sheet = figures.sheet()
    texts = {
        ".md": markdown(folder, figures, sheet, records),
        ".tex": _latex(folder, figures, sheet, records),
        ".csv": cells(figures),
    }
    written = []
    for suffix, text in texts.items():
        path = folder / f"{table.name}{suffix}"
        write_text(path, text)
        written.append(path)
    return written


def markdown(folder: Path, figures: Figures, sheet: Sheet, records: Sequence[Record]) -> str:
    """The table as a page.

    Args:
        folder: where it will lie.
        figures: its numbers.
        sheet: its cells.
        records: its records.
    """
    table = figures.table
    parts = [f"# {_plain(table.title)}\n", f"{_plain(caption(table, records))}\n", f"{table.about.strip()}\n"]
    if table.kind == "images":
        parts.append(_picture(folder, table))
    for block in sheet.blocks:
        rows = tuple(tuple(map(_cell, pieces)) for pieces in block.lines)
        parts += [f"## {_plain(block.title)}\n"] if block.title else []
        parts.append(PlainTable(sheet.columns, rows).markdown())
    parts += [f"{_reading(figures)}\n", "## Rows\n", _rows(table)]
    notes = "".join(f"- [{number}] {_plain(note)}\n" for number, note in enumerate(sheet.notes, 1))
    parts += ["## Missing\n", notes or "Nothing.\n", *_outside(figures)]
    parts += ["## Where the numbers come from\n"]
    parts.append("".join(f"- {label}: {_plain(text)}\n" for label, text in sources(folder, table, records)))
    return "\n".join(parts)


def cells(figures: Figures) -> str:
    """One line a cell, numbers with all their digits; empty where there is none, ``missing`` says why."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CELL)
    writer.writerows(_csv_lines(figures))
    return text.getvalue()


def summary_page(tables: Sequence[tuple[Table, Sequence[Record]]]) -> str:
    """An index of a scale's results, one line a table, and which of the paper's claims hold in them, as Markdown.

    Args:
        tables: descriptions with their records.

    Raises:
        InputError: there is no table, or a view was measured twice.
    """
    if not tables:
        raise InputError("summary", "has no table", "make a table first: gaussian-enhancer tables")
    scales = ", ".join(stated(table.scale for table, _ in tables))
    results = [Results(table, records) for table, records in tables]
    lines = tuple(_indexed(one, records) for one, (_, records) in zip(results, tables, strict=True))
    found = claims(results)
    verdicts = tuple((claim.text, claim.verdict, claim.counted) for claim in found)
    stand_ins = stated(f"{d.stand_in} for {d.title}" for t, _ in tables for d in t.datasets.values() if d.stand_in)
    parts = [
        f"# Results at scale {scales}\n" if scales else "# Results\n",
        PlainTable(("table", "title", "cells", "missing rows", "records", "commits"), lines).markdown(),
        "## The paper's claims\n",
        "Decided by the records: a difference counts where its 95 % bootstrap interval leaves out zero; a claim holds "
        "where all of its differences do, does not where one goes the other way, and is undecided else or where cells "
        "are missing.\n",
        PlainTable(("claim", "verdict", "comparisons"), verdicts).markdown(),
        *(_behind(claim) for claim in found),
    ]
    if stand_ins:
        parts += ["## Stand-ins\n", "".join(f"- {_plain(text)}\n" for text in stand_ins)]
    return "\n".join(parts)


def _behind(claim: Claim) -> str:
    """Every comparison of a claim."""
    words = {True: "as claimed", False: "against", None: "open"}
    lines = (f"- {words[outcome]}: {_plain(text)}\n" for outcome, text in claim.findings)
    return f"### {claim.text}: {claim.verdict}\n\n{''.join(lines)}"


def _indexed(results: Results, records: Sequence[Record]) -> tuple[str, ...]:
    """A table's line in the index; a cell is one metric of one row in one scene and block with one seed."""
    table = results.table
    samples = [
        results.values(block, row, metric) for block in results.blocks for row in table.rows for metric in table.metrics
    ]
    there, lacking = (sum(map(len, found)) for found in zip(*((s.values, s.missing) for s in samples), strict=True))
    gaps = sum(record.kind == MISSING for record in records)
    commits = ", ".join(stated(record.commit for record in records))
    link = f"[{table.name}]({table.name}.md)"
    return (link, _plain(table.title), f"{there} of {there + lacking}", str(gaps), str(len(records)), commits)


def _csv_lines(figures: Figures) -> Iterator[tuple[str, ...]]:
    table = figures.table
    words = {True: "higher", False: "lower", None: "neither"}
    for line in figures.lines:
        for metric, number in line.numbers.items():
            test = figures.tests.get((line.block, line.dataset, line.row, metric))
            tested = ("", "", "", "") if test is None else (_full(test.p), _full(test.corrected), test.units, test.unit)
            where = (table.name, table.scale, line.block, line.dataset, line.row, table.rows[line.row].title)
            found = (number.value, number.gain, number.low, number.high, number.deviation)
            status = (figures.best(line, metric), figures.best(line, metric, paper=True))
            yield (
                *where,
                line.statistic or "mean",
                metric,
                words[HIGHER_IS_BETTER[metric]],
                *map(_full, found),
                *map(str, tested),
                _full(number.paper),
                _full(number.paper_gain),
                *map(str, (number.scenes, number.seeds, number.views)),
                *("yes" if mark else "" for mark in status),
                "; ".join(number.reasons),
            )


def _latex(folder: Path, figures: Figures, sheet: Sheet, records: Sequence[Record]) -> str:
    table = figures.table
    picture = f"{table.name}.png" if table.kind == "images" and (folder / f"{table.name}.png").is_file() else ""
    stated_ = [f"{label}: {text}." for label, text in sources(folder, table, records)]
    remarks = [_reading(figures), *(part.strip() for part in _outside(figures)), *stated_]
    return latex.document(sheet, table.name, caption(table, records), remarks, picture)


def _reading(figures: Figures) -> str:
    scenes = max((number.scenes for line in figures.lines for number in line.numbers.values()), default=0)
    units = stated(test.unit for test in figures.tests.values())
    return reading(figures.table, units, alone=scenes == 1 and figures.table.kind != "cost")


def _outside(figures: Figures) -> list[str]:
    """Records that the description does not ask for, which no number holds."""
    others = figures.results.outside
    if not others:
        return []
    places = stated(" ".join(filter(None, (r.kind, r.scene, r.splat, r.variant, _seed(r.seed)))) for r in others)
    return [
        f"{len(others)} records are of what the table does not ask for, and are in no number: {', '.join(places)}.\n"
    ]


def _seed(seed: int | None) -> str:
    return "without a seed" if seed is None else f"seed {seed}"


def _picture(folder: Path, table: Table) -> str:
    name = f"{table.name}.png"
    return f"![{_plain(table.title)}]({name})\n" if (folder / name).is_file() else f"The grid `{name}` is missing.\n"


def _rows(table: Table) -> str:
    """What each row is and what makes it."""
    lines = []
    for name, row in table.rows.items():
        words = [_plain(row.about), f"weights `{row.weights}`" if row.weights else ""]
        words += [f"`{' '.join(overrides)}`" for overrides in (row.train, row.enhance) if overrides]
        lines.append(f"- {_plain(row.title)} (`{name}`): {'; '.join(word for word in words if word) or 'as it came'}\n")
    return "".join(lines)


def _cell(piece: Piece) -> str:
    text = f"**{piece.text}**" if piece.best else _plain(piece.text)
    return f"{text} {''.join(f'[{number}]' for number in piece.notes)}".strip()


def _plain(text: str) -> str:
    """Text in one line, with no HTML or emphasis of its own."""
    return " ".join(text.replace("<", "&lt;").replace("*", r"\*").split())


def _full(value: float | None) -> str:
    """Every digit, so that reading it gives the number again; empty where there is none."""
    return "" if value is None or math.isnan(value) else repr(float(value))
