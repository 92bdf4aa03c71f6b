"""Writes reports of a study from its description and records alone: Markdown, LaTeX, and CSV with one line per cell."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from ablations.report.caption import caption, reading, sources
from ablations.report.claims import Claim, claims
from ablations.study import latex
from ablations.study.description import TableDescription
from ablations.study.markdown import escape_markdown, frame, markdown
from ablations.study.rendered_table import Cell, RenderedTable, StudyTable
from ablations.study.results import Results
from ablations.study.sections import distinct_values
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.lpips import NO_BACKBONE, VARIANTS, backbone_place
from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER, MISSING, Record


def write_reports(folder: Path, study: TableDescription, records: Sequence[Record]) -> list[Path]:
    """Write ``<folder>/<name>.md``, ``.tex`` and ``.csv``, each atomically.

    Args:
        folder: folder of description and records; a grid of images ``<name>.png`` in it is shown.
        study: its description.
        records: its records, in any order.

    Returns:
        The paths of the files.

    Raises:
        InputError: a view was measured twice, or a file cannot be written.
    """
    table = StudyTable(study, records)
    rendered = table.rendered()
    texts = {
        ".md": page(folder, table, rendered, records),
        ".tex": _latex(folder, table, rendered, records),
        ".csv": cell_frame(table).to_csv(index=False, lineterminator="\n"),
    }
    for suffix, text in texts.items():
        write_text(folder / f"{study.name}{suffix}", text)
    return [folder / f"{study.name}{suffix}" for suffix in texts]


def page(folder: Path, table: StudyTable, rendered: RenderedTable, records: Sequence[Record]) -> str:
    """The table as a page of Markdown.

    Args:
        folder: folder of the page.
        table: the table's numbers.
        rendered: the table's text.
        records: the table's records.
    """
    study = table.study
    parts = [
        f"# {escape_markdown(study.title)}\n",
        f"{escape_markdown(caption(study, records))}\n",
        f"{study.about.strip()}\n",
    ]
    parts += [_picture(folder, study)] if study.kind == "images" else []
    for title, block in rendered.blocks:
        parts += [f"## {escape_markdown(title)}\n"] if title else []
        parts.append(markdown(block.map(_cell)))
    parts += [f"{_reading(table)}\n", "## Methods\n", _methods(study)]
    notes = "".join(f"- [{number}] {escape_markdown(note)}\n" for number, note in enumerate(rendered.notes, 1))
    notes += "".join(f"- {escape_markdown(place)}\n" for place in _backbone_places(table))
    parts += ["## Missing\n", notes or "Nothing.\n", *_uncovered_note(table), "## Where the numbers come from\n"]
    parts.append("".join(f"- {label}: {escape_markdown(text)}\n" for label, text in sources(folder, study, records)))
    return "\n".join(parts)


def cell_frame(table: StudyTable) -> pd.DataFrame:
    """One line per cell, with full precision; empty for a missing number, whose reason is in ``missing``."""
    return pd.DataFrame(list(_cells(table)))


def summary_page(studies: Sequence[tuple[TableDescription, Sequence[Record]]]) -> str:
    """An index of a scale's results with one line per study, and the verdicts on the paper's claims, as Markdown.

    Args:
        studies: descriptions with their records.

    Raises:
        InputError: there is no study, or a view was measured twice.
    """
    if not studies:
        raise InputError("summary", "has no table", "make a table first: gaussian-enhancer tables")
    scales = ", ".join(distinct_values(study.scale for study, _ in studies))
    results = [Results(study, records) for study, records in studies]
    lines = [_index_line(study_results, records) for study_results, (_, records) in zip(results, studies, strict=True)]
    judged_claims = claims(results)
    verdicts = [(claim.text, claim.verdict, claim.counts_text) for claim in judged_claims]
    stand_ins = distinct_values(
        f"{d.stand_in} for {d.title}" for s, _ in studies for d in s.datasets.values() if d.stand_in
    )
    parts = [
        f"# Results at scale {scales}\n" if scales else "# Results\n",
        markdown(frame(("table", "title", "cells", "missing methods", "records", "commits"), lines)),
        "## The paper's claims\n",
        "Judged on the paper's own rows alone, never on ours. Decided by the records: a difference counts where its "
        "95 % bootstrap interval leaves out zero. A claim holds if all its differences agree with it. It does "
        "not hold if one contradicts it. Otherwise, or if cells are missing, it is undecided.\n",
        markdown(frame(("claim", "verdict", "comparisons"), verdicts)),
        *map(_claim_section, judged_claims),
    ]
    if stand_ins:
        parts += ["## Stand-ins\n", "".join(f"- {escape_markdown(text)}\n" for text in stand_ins)]
    return "\n".join(parts)


def _claim_section(claim: Claim) -> str:
    """A claim with all of its comparisons, as Markdown."""
    outcome_texts = {True: "as claimed", False: "against", None: "open"}
    lines = (f"- {outcome_texts[outcome]}: {escape_markdown(text)}\n" for outcome, text in claim.findings)
    return f"### {claim.text}: {claim.verdict}\n\n{''.join(lines)}"


def _index_line(results: Results, records: Sequence[Record]) -> tuple[str, ...]:
    """A study's line in the index. A cell is one metric of one method in one scene and block, with one seed."""
    study = results.study
    places = [
        (block, method, metric) for block in results.blocks for method in study.methods for metric in study.metrics
    ]
    samples = [results.values(*place) for place in places]
    present, missing = (
        sum(map(len, mappings)) for mappings in zip(*((s.values, s.missing) for s in samples), strict=True)
    )
    missing_records = sum(record.kind == MISSING for record in records)
    commits = ", ".join(distinct_values(record.commit for record in records))
    link = f"[{study.name}]({study.name}.md)"
    return (
        link,
        escape_markdown(study.title),
        f"{present} of {present + missing}",
        str(missing_records),
        str(len(records)),
        commits,
    )


def _cells(table: StudyTable) -> Iterator[dict[str, Any]]:
    study = table.study
    for line in table.lines:
        for metric, number in line.numbers.items():
            test = table.tests.get((line.block, line.dataset, line.method, metric))
            yield {
                "table": study.name,
                "scale": study.scale,
                "block": line.block,
                "dataset": line.dataset,
                "method": line.method,
                "title": study.methods[line.method].title,
                "statistic": line.statistic or "mean",
                "metric": metric,
                "better": {True: "higher", False: "lower", None: "neither"}[HIGHER_IS_BETTER[metric]],
                "value": _full(number.value),
                "gain": _full(number.gain),
                "low": _full(number.low),
                "high": _full(number.high),
                "sd_over_seeds": _full(number.deviation),
                "p": "" if test is None else _full(test.p),
                "p_holm": "" if test is None else _full(test.corrected),
                "test_units": "" if test is None else str(test.units),
                "test_unit": "" if test is None else test.unit,
                "paper": _full(number.paper),
                "paper_gain": _full(number.paper_gain),
                "scenes": str(number.scenes),
                "seeds": str(number.seeds),
                "views": str(number.views),
                "best": "yes" if table.best(line, metric) else "",
                "paper_best": "yes" if table.best(line, metric, paper=True) else "",
                "missing": "; ".join(number.reasons),
            }


def _latex(folder: Path, table: StudyTable, rendered: RenderedTable, records: Sequence[Record]) -> str:
    study = table.study
    picture = f"{study.name}.png" if study.kind == "images" and (folder / f"{study.name}.png").is_file() else ""
    lines = [f"{label}: {text}." for label, text in sources(folder, study, records)]
    places = [f"{place}." for place in _backbone_places(table)]
    remarks = [_reading(table), *places, *(part.strip() for part in _uncovered_note(table)), *lines]
    return latex.latex_float(rendered, study.name, caption(study, records), remarks, picture)


def _reading(table: StudyTable) -> str:
    scenes = max((number.scenes for line in table.lines for number in line.numbers.values()), default=0)
    units = distinct_values(test.unit for test in table.tests.values())
    return reading(table.study, units, alone=scenes == 1 and table.study.kind != "cost")


def _uncovered_note(table: StudyTable) -> list[str]:
    """A sentence on records that the description does not cover, which are in no number; none if there are none."""
    uncovered = table.results.uncovered_records
    if not uncovered:
        return []
    seeds = ["without a seed" if record.seed is None else f"seed {record.seed}" for record in uncovered]
    record_seeds = zip(uncovered, seeds, strict=True)
    places = distinct_values(
        " ".join(filter(None, (r.kind, r.scene, r.splat, r.variant, seed))) for r, seed in record_seeds
    )
    count = len(uncovered)
    return [f"{count} records are of what the table does not ask for, and are in no number: {', '.join(places)}.\n"]


def _backbone_places(table: StudyTable) -> list[str]:
    """For every metric without a backbone, which file to put where, unless the reason in the records says so."""
    places = []
    for metric in table.study.metrics:
        reasons = [reason for line in table.lines for reason in line.numbers[metric].reasons if NO_BACKBONE in reason]
        if metric in VARIANTS and any(backbone_place(metric) not in reason for reason in reasons):
            places.append(f"To measure {table.quantities[metric].label}: {backbone_place(metric)}")
    return places


def _picture(folder: Path, study: TableDescription) -> str:
    name = f"{study.name}.png"
    return (
        f"![{escape_markdown(study.title)}]({name})\n"
        if (folder / name).is_file()
        else f"The grid `{name}` is missing.\n"
    )


def _methods(study: TableDescription) -> str:
    """A list of the methods: what each one is, its weights and its overrides."""
    lines = []
    for name, method in study.methods.items():
        parts = [escape_markdown(method.about), f"weights `{method.weights}`" if method.weights else ""]
        parts += [f"`{' '.join(overrides)}`" for overrides in (method.train, method.enhance) if overrides]
        lines.append(
            f"- {escape_markdown(method.title)} (`{name}`): {'; '.join(filter(None, parts)) or 'as it came'}\n"
        )
    return "".join(lines)


def _cell(cell: Cell) -> str:
    text = f"**{cell.text}**" if cell.best else escape_markdown(cell.text)
    return f"{text} {''.join(f'[{number}]' for number in cell.notes)}".strip()


def _full(value: float | None) -> str:
    """A number with all digits, so that it can be read back exactly; empty if unknown."""
    return "" if value is None or math.isnan(value) else repr(float(value))
