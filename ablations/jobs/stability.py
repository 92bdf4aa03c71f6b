"""``gaussian-enhancer stability``: stiff and extreme cases in every precision, as records, a page and diagrams."""

import os
from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from ablations.report.stability import matrix_plot, order_plot, stability_page
from ablations.stability.case import Case
from ablations.stability.catalogue import catalogue
from ablations.stability.judge import FAILED, KIND
from ablations.stability.order import measured_order
from ablations.stability.sampler import SCHEDULES
from ablations.stability.watched import measured
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.records import Record, append_records, read_records, write_records
from gaussian_enhancer.runs.instantiate import require
from gaussian_enhancer.runs.runtime import start


def run(cfg: DictConfig) -> float | None:
    """Compute the matrix, or write its page again; a killed matrix goes on with the cells that it lacks.

    Args:
        cfg: see ``conf/stability.yaml``.

    Returns:
        How many cells have failed.

    Raises:
        InputError: the configuration names no case, or a file cannot be read or written.
    """
    require(cfg)
    start(cfg.runtime)
    console = Console(stderr=True)
    families = None if cfg.families is None else list(cfg.families)
    cases = catalogue(families, None if cfg.cases is None else list(cfg.cases))
    source, page = Path(cfg.records), Path(cfg.markdown)
    if not cfg.records_only:
        partial = source.with_suffix(".part.jsonl")
        _measure(cfg, cases, partial, console)
        write_records(source, _sorted(read_records(partial), cases))
        partial.unlink()
    records = read_records(source)
    _refuse_unknown(records)
    _write(page, source, records, catalogue())
    failed = sum(record.kind == KIND and record.variant == FAILED for record in records)
    console.print(f"{page}, {source}: {failed} cells have failed", highlight=False, soft_wrap=True)
    return float(failed)


def _measure(cfg: DictConfig, cases: Sequence[Case], partial: Path, console: Console) -> None:
    """Append what is not there yet: the matrix, each failure named as it comes, then the sampler's order."""
    held = read_records(partial) if partial.is_file() else ()
    cells = {(record.scene, record.splat, record.view) for record in held if record.kind == KIND}
    for record in measured(cases, threads=cfg.runtime.threads or os.cpu_count() or 1, known=cells):
        append_records(partial, [record])
        if record.variant == FAILED:
            words = f"{record.scene} {record.splat} {record.view}: {record.reasons['outcome']}"
            console.print(words, highlight=False, soft_wrap=True, markup=False)
    known = {record.scene for record in held if record.kind != KIND}
    for name in SCHEDULES:
        others = known | set(SCHEDULES) - {name}
        append_records(partial, measured_order(tuple(cfg.order.steps), cfg.order.finest, others))


def _sorted(records: Sequence[Record], cases: Sequence[Case]) -> list[Record]:
    """The records of these cases in the catalogue's order, then the others; those of other cases are left out."""
    places = {case.name: place for place, case in enumerate(cases)}
    cells = [record for record in records if record.kind == KIND and record.scene in places]
    cells.sort(key=lambda record: places[record.scene])
    return [*cells, *(record for record in records if record.kind != KIND)]


def _write(page: Path, source: Path, records: Sequence[Record], cases: Sequence[Case]) -> None:
    folder = page.with_suffix("")
    cells = [record for record in records if record.kind == KIND]
    order = [record for record in records if record.kind != KIND]
    figures = {"matrix": matrix_plot(cells), **({"order": order_plot(order)} if order else {})}
    for name, figure in figures.items():
        write_text(folder / f"{name}.svg", figure)
    link = Path(os.path.relpath(source, page.parent)).as_posix()
    links = {name: f"{folder.name}/{name}.svg" for name in figures}
    write_text(page, stability_page(records, cases, links, link))


def _refuse_unknown(records: Sequence[Record]) -> None:
    """Refuse records without a single cell, of which no page can be made."""
    if not any(record.kind == KIND for record in records):
        raise InputError("records", "hold no cell of the matrix", "run gaussian-enhancer stability")
