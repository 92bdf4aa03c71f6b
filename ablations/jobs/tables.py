"""``gaussian-enhancer tables``: makes any table, figure or study, from fits to reports, by one command.

Fits, trainings and measurements are separate runs, made where they are missing and shared by all tables, so a killed
job resumes. The table's description and records are written together; reports are made from these alone.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from ablations.realism.real_crops import KINDS, crops, worst
from ablations.report.grids import PHOTO, Box, write_grid
from ablations.report.tables import summary_page, write_reports
from ablations.study.description import SceneGroup, read_description, write_description
from ablations.suite.cluster import make_runs_ahead
from ablations.suite.costs import cost_records
from ablations.suite.descriptions import Experiment, known_names, read_experiment, requested_names
from ablations.suite.evaluation import StudyCell, check_same_views
from ablations.suite.method_runs import Runs, with_backbones
from ablations.suite.plan import format_plan, plan_runs
from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import InputError, reason_of
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.records import MISSING, Record, missing_record, read_records, write_records
from gaussian_enhancer.runs.instantiate import require
from gaussian_enhancer.scene.photos import read_photo


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
        print(format_plan(plan_runs(cfg, experiments)))
        return
    console, folder, runs = Console(stderr=True), Path(cfg.results) / cfg.scale.name, Runs(cfg)
    if not cfg.records_only:
        runs.failures |= make_runs_ahead(cfg, experiments, console)
    for experiment in experiments:
        console.rule(f"{experiment.table.name}: {experiment.table.title}", align="left")
        if not cfg.records_only:
            records = list(made(runs, experiment, console))
            write_description(folder / f"{experiment.table.name}.json", experiment.table)
            write_records(folder / f"{experiment.table.name}.jsonl", records)
            if experiment.table.kind == "images":
                draw(runs, experiment, records, folder)
        report(folder, experiment.table.name, console)
    index(folder)


def made(runs: Runs, experiment: Experiment, console: Console) -> Iterator[Record]:
    """The records of a table; where a method cannot be made in a cell, a record states the reason."""
    if experiment.table.kind == "cost":
        yield from cost_records(runs, experiment, console)
        return
    for number, cell in enumerate(experiment.cells, 1):
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


def draw(runs: Runs, experiment: Experiment, records: Sequence[Record], folder: Path) -> None:
    """Write the grid of a figure: the first measured view of each scene and splat, or a row for each type of artefact.

    Args:
        runs: the suite's.
        experiment: the figure.
        records: its records; missing images become grey tiles.
        folder: of the file ``NAME.png``.
    """
    pictures: dict[tuple[str, str], Path] = {}
    lines: list[str] = []
    boxes: dict[str, Box] = {}
    for cell in experiment.cells:
        files_by_method = _method_views(runs, experiment, cell, records)
        views = sorted(files_by_method.get(experiment.table.baseline, {}))
        for label, view, box in _shown(experiment, f"{cell.scene}, {cell.splat}", files_by_method, views):
            lines.append(label)
            boxes |= {} if box is None else {label: box}
            method_files = {method: files[view] for method, files in files_by_method.items() if view in files}
            pictures |= {(label, key): path for key, path in method_files.items() if path.is_file()}
    if pictures:
        shown = replace(experiment.table, datasets={"all": SceneGroup("", tuple(lines))})
        write_grid(folder / f"{experiment.table.name}.png", shown, pictures, boxes=boxes)


def _method_views(
    runs: Runs, experiment: Experiment, cell: StudyCell, records: Sequence[Record]
) -> dict[str, dict[str, Path]]:
    """Image files of a cell by method and view; the photos under `PHOTO`."""
    files: dict[str, dict[str, Path]] = {}
    for method in experiment.table.methods:
        key = cell.scene, cell.splat, method
        views = [r.view for r in records if (r.scene, r.splat, r.variant) == key and r.view]
        if views:
            images, photos = runs.images(experiment, cell, method, experiment.seeds(method)[0])
            files[method] = {view: images / view for view in views}
            photo_files = {view: next(photos.glob(f"{Path(view).stem}.*"), None) for view in views}
            files.setdefault(PHOTO, {}).update({view: path for view, path in photo_files.items() if path})
    return files


def _shown(
    experiment: Experiment, label: str, files: Mapping[str, Mapping[str, Path]], views: Sequence[str]
) -> Iterator[tuple[str, str, Box | None]]:
    """Rows of a cell: label, view, and the crop where it is chosen by a type of artefact."""
    photos = files.get(PHOTO, {})
    photographed = [view for view in views if view in photos]
    if not experiment.table.artefacts or not photographed:
        yield label, min(views, default=""), None
        return
    pairs = [(read_photo(files[experiment.table.baseline][view]), read_photo(photos[view])) for view in photographed]
    height, width = pairs[0][0].shape[-2:]
    size = max(1, height // 3), max(1, width // 3)
    view_crops = crops(pairs, size)
    for name in experiment.table.artefacts:
        crop = worst(view_crops, KINDS[name])
        top, left = crop.place[0] / height, crop.place[1] / width
        yield f"{label}: {name}", photographed[crop.view], (left, top, left + size[1] / width, top + size[0] / height)


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
