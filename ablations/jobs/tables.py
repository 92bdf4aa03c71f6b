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
from ablations.suite.descriptions import Experiment, asked_names, known_names, read_experiment
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
    experiments = [read_experiment(name, cfg.scale) for name in asked_names(cfg.table)]
    if cfg.dry_run:
        print(format_plan(plan_runs(cfg, experiments)))
        return
    console, folder, runs = Console(stderr=True), Path(cfg.results) / cfg.scale.name, Runs(cfg)
    if not cfg.records_only:
        runs.failures |= make_runs_ahead(cfg, experiments, console)
    for one in experiments:
        console.rule(f"{one.table.name}: {one.table.title}", align="left")
        if not cfg.records_only:
            found = list(made(runs, one, console))
            write_description(folder / f"{one.table.name}.json", one.table)
            write_records(folder / f"{one.table.name}.jsonl", found)
            if one.table.kind == "images":
                draw(runs, one, found, folder)
        report(folder, one.table.name, console)
    index(folder)


def made(runs: Runs, one: Experiment, console: Console) -> Iterator[Record]:
    """The records of a table; where a method cannot be made in a cell, a record states the reason."""
    if one.table.kind == "cost":
        yield from cost_records(runs, one, console)
        return
    for number, cell in enumerate(one.cells, 1):
        console.print(f"{number} of {len(one.cells)}: {cell.scene}, {cell.splat}", highlight=False)
        views: dict[str, tuple[str, ...]] = {}
        for method in one.table.methods:
            for seed in one.seeds(method):
                found = _method(runs, one, cell, method, seed, console)
                if found[0].kind != MISSING:
                    views[f"{method}, seed {seed}"] = tuple(sorted(record.view for record in found))
                yield from found
        check_same_views(f"{cell.scene}, {cell.splat}", views)


def _method(
    runs: Runs, one: Experiment, cell: StudyCell, method: str, seed: int | None, console: Console
) -> tuple[Record, ...]:
    """A method's records in a cell, or one record with the reason why there are none; damaged records are refused."""
    try:
        runs.make(one, cell, method, seed)
    except (
        Exception
    ) as error:  # the other cells are made whatever the error is; the record and the run's status keep it
        reason = reason_of(error)
        print_line(console, f"{method} is missing: {reason}")
        if not isinstance(error, InputError):
            console.print_exception()
        return (missing_record(method, reason, scene=cell.scene, splat=cell.splat, seed=seed),)
    return runs.records(one, cell, method, seed)


def draw(runs: Runs, one: Experiment, records: Sequence[Record], folder: Path) -> None:
    """Write the grid of a figure: the first measured view of each scene and splat, or a row for each type of artefact.

    Args:
        runs: the suite's.
        one: the figure.
        records: its records; missing images become grey tiles.
        folder: of the file ``NAME.png``.
    """
    pictures: dict[tuple[str, str], Path] = {}
    lines: list[str] = []
    boxes: dict[str, Box] = {}
    for cell in one.cells:
        there = _method_views(runs, one, cell, records)
        views = sorted(there.get(one.table.baseline, {}))
        for label, view, box in _shown(one, f"{cell.scene}, {cell.splat}", there, views):
            lines.append(label)
            boxes |= {} if box is None else {label: box}
            found = {method: files[view] for method, files in there.items() if view in files}
            pictures |= {(label, key): path for key, path in found.items() if path.is_file()}
    if pictures:
        shown = replace(one.table, datasets={"all": SceneGroup("", tuple(lines))})
        write_grid(folder / f"{one.table.name}.png", shown, pictures, boxes=boxes)


def _method_views(
    runs: Runs, one: Experiment, cell: StudyCell, records: Sequence[Record]
) -> dict[str, dict[str, Path]]:
    """Image files of a cell by method and view; the photos under `PHOTO`."""
    found: dict[str, dict[str, Path]] = {}
    for method in one.table.methods:
        own = [r.view for r in records if (r.scene, r.splat, r.variant) == (cell.scene, cell.splat, method) and r.view]
        if own:
            images, photos = runs.images(one, cell, method, one.seeds(method)[0])
            found[method] = {view: images / view for view in own}
            beside = {view: next(photos.glob(f"{Path(view).stem}.*"), None) for view in own}
            found.setdefault(PHOTO, {}).update({view: path for view, path in beside.items() if path})
    return found


def _shown(
    one: Experiment, label: str, there: Mapping[str, Mapping[str, Path]], views: Sequence[str]
) -> Iterator[tuple[str, str, Box | None]]:
    """Rows of a cell: label, view, and the crop where it is chosen by a type of artefact."""
    photos = there.get(PHOTO, {})
    both = [view for view in views if view in photos]
    if not one.table.artefacts or not both:
        yield label, min(views, default=""), None
        return
    pairs = [(read_photo(there[one.table.baseline][view]), read_photo(photos[view])) for view in both]
    height, width = pairs[0][0].shape[-2:]
    size = max(1, height // 3), max(1, width // 3)
    found = crops(pairs, size)
    for name in one.table.artefacts:
        crop = worst(found, KINDS[name])
        top, left = crop.place[0] / height, crop.place[1] / width
        yield f"{label}: {name}", both[crop.view], (left, top, left + size[1] / width, top + size[0] / height)


def index(folder: Path) -> None:
    """Write the index of all tables that a scale has.

    Raises:
        InputError: one of them was damaged.
    """
    names = [name for group in known_names().values() for name in group]
    there = [name for name in names if all((folder / f"{name}{end}").is_file() for end in (".json", ".jsonl"))]
    found = [(read_description(folder / f"{name}.json"), read_records(folder / f"{name}.jsonl")) for name in there]
    write_text(folder / "README.md", summary_page(found))


def report(folder: Path, name: str, console: Console) -> None:
    """Write a table's reports from its description and records.

    Raises:
        InputError: they are missing or damaged.
    """
    table, records = read_description(folder / f"{name}.json"), read_records(folder / f"{name}.jsonl")
    for path in write_reports(folder, table, records):
        print_line(console, str(path))
