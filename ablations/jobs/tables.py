"""``gaussian-enhancer tables``: makes any table, figure or study, from fits to reports, by one command.

Fits, trainings and measurements are separate runs, made where they are missing and shared by all tables, so a killed
job resumes. Each table is a study of its cells; its reports are made from its description and records alone.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from omegaconf import DictConfig
from rich.console import Console

from ablations.report.tables import summary_page, write_reports
from ablations.study.description import read_description, write_description
from ablations.study.engine import Study, measure_and_add
from ablations.study.missing import missing_record, reason_of
from ablations.study.rows import RowFile
from ablations.suite.cluster import make_runs_ahead, worker_count
from ablations.suite.costs import cost_records
from ablations.suite.descriptions import Experiment, known_names, read_experiment, requested_names
from ablations.suite.dry_run import format_plan
from ablations.suite.evaluation import StudyCell, check_same_views
from ablations.suite.figures import draw_figure
from ablations.suite.method_runs import Runs, with_backbones
from ablations.suite.plan import plan_runs
from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.records import MISSING, Record, read_records
from gaussian_enhancer.runs.instantiate import require

KEYS = ("variant", "scene", "splat", "seed", "view")


def output_path(cfg: DictConfig) -> Path | None:
    """The folder of the scale's tables; None for a dry run."""
    return None if cfg.dry_run else Path(cfg.results) / cfg.scale.name


def run(cfg: DictConfig) -> None:
    """Make tables, or print the plan and its cost.

    Args:
        cfg: conf/tables.yaml, composed.

    Raises:
        InputError: a name is unknown, a record was damaged, or a file cannot be read or written.
    """
    cfg = with_backbones(cfg)
    require(cfg)
    experiments = [read_experiment(name, cfg.scale) for name in requested_names(cfg.table)]
    if cfg.dry_run:
        workers = None if cfg.scheduler else worker_count(cfg)  # a scheduler has as many as joined it
        print(format_plan(plan_runs(cfg, experiments), workers))
        return
    console, folder, runs = Console(stderr=True), Path(cfg.results) / cfg.scale.name, Runs(cfg)
    if not cfg.records_only:
        runs.failures |= make_runs_ahead(cfg, experiments, console)
    for experiment in experiments:
        table = experiment.table
        console.rule(f"{table.name}: {table.title}", align="left")
        if not cfg.records_only:
            file = RowFile(folder / f"{table.name}.jsonl", KEYS)
            measure_and_add(study(runs, experiment, console), file)
            write_description(folder / f"{table.name}.json", table)
            if table.kind == "images":
                draw_figure(runs, experiment, read_records(file.path), folder)
        report(folder, table.name, console)
    index(folder)


def study(runs: Runs, experiment: Experiment, console: Console) -> Study[Any]:
    """A table as a study: of its cells, or as a whole where methods are timed in turn."""
    table = experiment.table
    if table.kind == "cost":
        return Study((table.name,), lambda _: cost_records(runs, experiment, console), KEYS, replaces_file=True)
    return Study(experiment.cells, lambda cell: cell_records(runs, experiment, cell, console), KEYS, replaces_file=True)


def cell_records(runs: Runs, experiment: Experiment, cell: StudyCell, console: Console) -> Iterator[Record]:
    """The records of a cell of a table; where a method cannot be made, a record states the reason."""
    number = experiment.cells.index(cell) + 1
    console.print(f"{number} of {len(experiment.cells)}: {cell.scene}, {cell.splat}", highlight=False)
    views: dict[str, tuple[str, ...]] = {}
    for method in experiment.table.methods:
        for seed in experiment.seeds(method):
            method_records = _method(runs, experiment, cell, method, seed, console)
            if method_records[0].kind != MISSING:
                views[f"{method}, seed {seed}"] = tuple(sorted(record.view for record in method_records))
            yield from method_records
    check_same_views(f"{cell.scene}, {cell.splat}", views)


def _method(
    runs: Runs, experiment: Experiment, cell: StudyCell, method: str, seed: int | None, console: Console
) -> tuple[Record, ...]:
    """A method's records in a cell, or one record with the reason why there are none; damaged records are refused."""
    try:
        runs.make(experiment, cell, method, seed)
    except (
        Exception
    ) as error:  # the other cells are made whatever the error is; the record and the run's status keep it
        reason = reason_of(error)
        print_line(console, f"{method} is missing: {reason}")
        if not isinstance(error, InputError):
            console.print_exception()
        return (missing_record(method, reason, scene=cell.scene, splat=cell.splat, seed=seed),)
    return runs.records(experiment, cell, method, seed)


def index(folder: Path) -> None:
    """Write the index of all tables that a scale has.

    Raises:
        InputError: one of them was damaged.
    """
    names = [name for group in known_names().values() for name in group]
    complete = [name for name in names if all((folder / f"{name}{end}").is_file() for end in (".json", ".jsonl"))]
    studies = [(read_description(folder / f"{name}.json"), read_records(folder / f"{name}.jsonl")) for name in complete]
    write_text(folder / "README.md", summary_page(studies))


def report(folder: Path, name: str, console: Console) -> None:
    """Write a table's reports from its description and records.

    Raises:
        InputError: they are missing or damaged.
    """
    table, records = read_description(folder / f"{name}.json"), read_records(folder / f"{name}.jsonl")
    for path in write_reports(folder, table, records):
        print_line(console, str(path))
