"""The page of a quality study as Markdown, from its records alone: aims, scenes, cells, harm, sources."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ablations.records.gains import VERDICTS, Aims, Cell, Study, better
from ablations.report.sources import sources
from gaussian_enhancer.metrics.comparison import Table, written
from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER, Record

METRICS = ("psnr", "psnr_aligned", "ssim", "lpips_alex", "lpips_vgg")
"""The page's metrics in their order; those without a single record are left out."""

TITLES = {
    "psnr": "PSNR, dB",
    "psnr_aligned": "colour-aligned PSNR, dB",
    "ssim": "SSIM",
    "lpips_alex": "LPIPS (alex)",
    "lpips_vgg": "LPIPS (vgg)",
}


@dataclass(frozen=True)
class Section:
    """One table of the page.

    Args:
        title: its heading.
        about: a paragraph under it.
        study: its records.
        aims: what its own rows are to show.
        described: what each row is, by name.
    """

    title: str
    about: str
    study: Study
    aims: Aims
    described: Mapping[str, str]


def quality_page(title: str, about: str, sections: Sequence[Section], source: str) -> str:
    """The whole page.

    Args:
        title: its heading.
        about: what was measured and by which command, Markdown.
        sections: its tables.
        source: the records' file, as the page links it.
    """
    parts = [f"# {title}\n", f"{about.strip()}\n"]
    for section in sections:
        parts += section_parts(section)
    records = [r for s in sections for views in s.study.records.values() for r in views.values()]
    parts += ["## Where the numbers come from\n", _sources(records, source)]
    return "\n".join(parts)


def section_parts(section: Section) -> list[str]:
    """Headings and tables of a section: rows, aims, scenes, harm, cells, what is missing."""
    study = section.study
    parts = [f"## {section.title}\n", f"{section.about.strip()}\n", _rows(section)]
    if study.ours:
        parts += ["### Aims\n", aims_table(section).markdown()]
    parts += ["### By scene\n", _READING, scene_table(study).markdown()]
    if section.aims.allowed:
        parts += ["### Frames made worse\n", _harm(section)]
    for metric in metrics_of(study):
        parts += [f"### By cell: {TITLES[metric]}\n", cell_table(study, metric).markdown()]
    return [*parts, "### Missing\n", _missing(study)]


def metrics_of(study: Study) -> tuple[str, ...]:
    """The page's metrics that at least one frame was measured in."""
    found = {name for views in study.records.values() for r in views.values() for name, v in r.metrics.items() if v}
    return tuple(name for name in METRICS if name in found)


def aims_table(section: Section) -> Table:
    """One line an aim: row, scene, aim, what was found, whether it is met."""
    verdicts = [v for row in section.study.ours for v in section.study.verdicts(row, section.aims)]
    rows = tuple((v.row, v.scene, v.aim, v.found, VERDICTS[v.met]) for v in verdicts)
    return Table(("row", "scene", "aim", "found", "verdict"), rows)


def scene_table(study: Study) -> Table:
    """One line a scene and row: mean and gain of every metric, frames and cells."""
    names = metrics_of(study)
    rows = []
    for scene in study.scenes:
        for row in study.rows:
            cells = study.of_scene(scene)
            known = [cell for cell in cells if not study.why_missing(cell, row)]
            counts = f"{len(known)} of {len(cells)}"
            rows.append((scene, row, counts, *(_with_interval(study, known, row, name) for name in names)))
    return Table(("scene", "row", "cells", *(TITLES[name] for name in names)), tuple(rows))


def cell_table(study: Study, metric: str) -> Table:
    """One line a cell, one column a row: mean over frames and gain over the baseline."""
    rows = []
    for cell in study.cells:
        frames = len(study.records.get((cell, study.baseline), {}))
        numbers = (_mean_and_gain(study, cell, row, metric) for row in study.rows)
        rows.append((*cell, str(frames), *numbers))
    return Table(("scene", "splat", "frames", *study.rows), tuple(rows))


_READING = (
    "Mean over cells (each scene, method and density counts alike), then the gain over the first row with its 95% "
    "interval (bootstrap over frames within cells). A row that lacks cells is averaged over those that it has, and its "
    "gain is over the first row on the same cells.\n"
)


def _rows(section: Section) -> str:
    return "".join(f"- `{row}`: {section.described.get(row) or 'no description'}\n" for row in section.study.rows)


def _with_interval(study: Study, cells: Sequence[Cell], row: str, metric: str) -> str:
    means = [mean for cell in cells if not math.isnan(mean := _mean(study, cell, row, metric))]
    if not means:
        return "missing"
    value = written(metric, sum(means) / len(means))
    if row == study.baseline:
        return value
    gain = study.gain(cells, row, metric)
    low, high = (written(metric, end, signed=True) for end in (gain.low, gain.high))
    return f"{value} ({written(metric, gain.value, signed=True)} [{low}, {high}])"


def _mean_and_gain(study: Study, cell: Cell, row: str, metric: str) -> str:
    mean = _mean(study, cell, row, metric)
    if math.isnan(mean):
        return "missing"
    if row == study.baseline:
        return written(metric, mean)
    gain = study.gain([cell], row, metric)
    return f"{written(metric, mean)} ({written(metric, gain.value, signed=True)})"


def _mean(study: Study, cell: Cell, row: str, metric: str) -> float:
    """Mean over a cell's frames; NaN without any."""
    values = [record.metrics.get(metric) for record in study.records.get((cell, row), {}).values()]
    known = [value for value in values if value is not None and math.isfinite(value)]
    return sum(known) / len(known) if known else math.nan


def _harm(section: Section) -> str:
    """By row: how many frames lose more than is allowed, each named for rows of ours, and the worst frame."""
    study, lines = section.study, []
    for row in study.rows[1:]:
        if not any(name == row for _, name in study.records):
            continue
        worse = study.worse(row, section.aims.allowed)
        for metric, limit in section.aims.allowed.items():
            losses = [(pair.baseline, gain) for pair, name, gain in worse if name == metric]
            total = sum(len(study.pairs(cell, row)) for cell in study.cells)
            line = f"- `{row}`, more than {limit:g} in `{metric}`: {len(losses)} of {total}"
            if losses and row in study.ours:
                line += ": " + ", ".join(f"{_place(record)} ({gain:+.4f})" for record, gain in losses)
            worst = study.worst(row, metric)
            if worst is not None:
                line += f"; least gain {worst[1]:+.4f} at {_place(worst[0].baseline)}"
            lines.append(line + "\n")
    return "".join(lines) or "No row was compared.\n"


def _place(record: Record) -> str:
    return f"{record.scene} {record.splat} {record.view}"


def _missing(study: Study) -> str:
    """Every reason with the rows and cells that it keeps from the page."""
    found: dict[str, dict[str, list[str]]] = {}
    for row in study.rows:
        for cell in study.cells:
            if reason := study.why_missing(cell, row):
                found.setdefault(reason, {}).setdefault(row, []).append(" ".join(cell))
    for (_, row), views in study.records.items():
        for record in views.values():
            for metric, reason in record.reasons.items():
                found.setdefault(f"{metric}: {reason}", {}).setdefault(row, []).append(_place(record))
    lines = (f"- {reason}: {_places(rows, len(study.cells))}\n" for reason, rows in found.items())
    return "".join(lines) or "Nothing.\n"


def _places(rows: Mapping[str, Sequence[str]], cells: int) -> str:
    """Rows with the places that they lack, short where those are all cells."""
    named = (f"all {cells} cells" if len(places) == cells else ", ".join(places) for places in rows.values())
    return "; ".join(f"`{row}` in {places}" for row, places in zip(rows, named, strict=True))


def _sources(records: Iterable[Record], source: str) -> str:
    """Protocol, machine, commit and time of the records."""
    records = list(records)
    way = ", ".join(f"{n} {_way(n)}" for n in METRICS if any(n in r.metrics for r in records))
    return sources(records, source, "frames: ") + f"- better is {way}\n"


def _way(metric: str) -> str:
    return "higher" if HIGHER_IS_BETTER[metric] and better(metric) > 0 else "lower"
