"""``gaussian-enhancer stability``: stiff and extreme cases in every precision, as records, a page and diagrams."""

import os
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import torch
from omegaconf import DictConfig
from rich.console import Console

from ablations.report.stability import matrix_plot, order_plot, stability_page
from ablations.stability.case import Case
from ablations.stability.catalogue import catalogue
from ablations.stability.judge import FAILED, KIND
from ablations.stability.order import order_records
from ablations.stability.sampler import SCHEDULES
from ablations.stability.watched import matrix_records
from ablations.study.engine import Study, job
from ablations.study.processor import refuse_gpu
from ablations.study.sections import relative_link
from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.records import Record, read_records


def study(cfg: DictConfig, device: torch.device) -> Study[str]:
    """The cases, family by family, then the order of the sampler's error, schedule by schedule.

    Raises:
        InputError: the configuration names an unknown case or family.
    """
    refuse_gpu(device)
    names = None if cfg.cases is None else list(cfg.cases)
    cases = catalogue(None if cfg.families is None else list(cfg.families), names)
    families = {case.family: [member for member in cases if member.family == case.family] for case in cases}
    threads = cfg.runtime.threads or os.cpu_count() or 1
    steps, finest = tuple(cfg.order.steps), int(cfg.order.finest)
    measurements = {name: partial(_told, family_cases, threads) for name, family_cases in families.items()}
    measurements |= {f"order of {name}": partial(order_records, name, steps, finest) for name in SCHEDULES}
    report = partial(_reported, Path(cfg.records), Path(cfg.markdown))
    chosen = () if cfg.records_only else tuple(measurements)
    return Study(chosen, lambda name: measurements[name](), ("kind", "scene"), option="families", report=report)


run = job(study)


def _told(cases: Sequence[Case], threads: int) -> Iterator[Record]:
    """Yield the cells of cases and print each failure."""
    console = Console(stderr=True)
    for record in matrix_records(cases, threads=threads):
        if record.variant == FAILED:
            outcome = f"{record.scene} {record.splat} {record.view}: {record.reasons['outcome']}"
            print_line(console, outcome)
        yield record


def _reported(source: Path, page: Path) -> float:
    """Write page and diagrams; return the number of failed cells."""
    cases = catalogue()
    order = {case.name: index for index, case in enumerate(cases)}
    all_records = read_records(source)
    cells = [record for record in all_records if record.kind == KIND]
    cells.sort(key=lambda record: order.get(record.scene, len(order)))
    others = [record for record in all_records if record.kind != KIND]
    if not cells:
        raise InputError("records", "contain no cell of the matrix", "run gaussian-enhancer stability")
    figures = {"matrix": matrix_plot(cells), **({"order": order_plot(others)} if others else {})}
    for name, figure in figures.items():
        write_text(page.with_suffix("") / f"{name}.svg", figure)
    links = {name: f"{page.stem}/{name}.svg" for name in figures}
    write_text(page, stability_page([*cells, *others], cases, links, relative_link(source, page)))
    failed = sum(record.variant == FAILED for record in cells)
    print_line(Console(stderr=True), f"{page}, {source}: {failed} cells have failed")
    return float(failed)
