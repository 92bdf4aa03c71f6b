"""``gaussian-enhancer quality``: measures every method on every cell; one page states aims and missing results.

Each step is a content-addressed run: a killed study resumes, and only what has changed is computed again.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from omegaconf import DictConfig
from rich.console import Console

from ablations.report.quality import quality_page
from ablations.study.aims import Aims
from ablations.study.description import MethodDescription, SceneGroup, TableDescription
from ablations.study.engine import Study, job
from ablations.study.missing import missing_record
from ablations.study.results import Results
from ablations.study.sections import relative_link
from ablations.suite.evaluation import StudyCell, check_same_views, image_records, method_images
from ablations.suite.method_runs import with_backbones
from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import InputError, refuse_unknown
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.records import Record, read_records

CONSOLE = Console(stderr=True)
ROLES = ("other", "ours")


def study(cfg: DictConfig, device: torch.device) -> Study[tuple[str, str, StudyCell]]:
    """Every method in every cell of every table.

    Raises:
        InputError: the configuration names no cell, or an unknown scene, splat or role.
    """
    cfg = with_backbones(cfg)
    cells = {str(name): tuple(study_cells(cfg, table)) for name, table in cfg.tables.items()}
    _refuse_unknown(cfg)
    cells_to_measure = [
        (name, f"{name} {number} of {len(table_cells)}: {cell.scene}, {cell.splat}", cell)
        for name, table_cells in cells.items()
        for number, cell in enumerate(table_cells, 1)
    ]
    return Study(
        () if cfg.records_only else cells_to_measure,
        lambda part: _measured(cfg, *part),
        ("variant", "scene", "splat"),
        replaces_file=cfg.scenes is None and cfg.splats is None,  # of some scenes or splats, others' records stay
        report=lambda: _reported(cfg),
    )


run = job(study)


def _reported(cfg: DictConfig) -> float | None:
    """Write the page.

    Returns:
        Mean gain in colour-aligned PSNR of the last method in the first table over all cells, dB; None where
        it is missing.
    """
    source, page = Path(cfg.records), Path(cfg.markdown)
    records = read_records(source)
    tables = [_table(cfg, str(name), records) for name in cfg.tables]
    write_text(page, quality_page(cfg.title, cfg.about, tables, relative_link(source, page)))
    print_line(CONSOLE, f"{page}, {source}")
    results, _ = tables[0]
    last_method = tuple(results.study.methods)[-1]
    gains = results.sample(results.pairs, last_method, "psnr_aligned", results.study.baseline)
    return gains.mean() if gains.values else None


def study_cells(cfg: DictConfig, table: DictConfig) -> Iterator[StudyCell]:
    """The cells of a table: scenes x splats x densities, without those that the table or the user leaves out."""

    def included(name: str, choices: Sequence[str] | None) -> bool:
        return choices is None or name in choices

    for group in cfg.groups.values():
        for scene, overrides in group.scenes.items():
            if scene in table.get("without", ()) or not included(scene, cfg.scenes):
                continue
            for splat in cfg.splat_choices:
                for density, choice in group.densities.items():
                    splat_included = included(splat, cfg.splats) and included(splat, table.get("splats"))
                    if splat_included and included(density, table.get("densities")):
                        fit = (*overrides, f"splat={splat}", *cfg.fit, *choice.fit)
                        every = table.get("every", choice.every)
                        yield StudyCell(str(scene), f"{splat}/{density}", fit, every, bool(table.get("finer")))


def _measured(cfg: DictConfig, name: str, title: str, cell: StudyCell) -> Iterator[Record]:
    """Records of every method in a cell of a table; a method that cannot be made leaves one with the reason."""
    CONSOLE.rule(title, align="left")
    views: dict[str, tuple[str, ...]] = {}
    for method, choice in cfg.tables[name].methods.items():
        try:
            records = image_records(cfg, cell, str(method), method_images(cfg, cell, str(method), choice))
        except InputError as error:
            print_line(CONSOLE, f"{method} is missing: {error}")
            records = (missing_record(str(method), str(error), scene=cell.scene, splat=cell.splat),)
        else:
            views[str(method)] = tuple(sorted(record.view for record in records))
        yield from (replace(record, variant=f"{name}/{method}") for record in records)
    check_same_views(f"{cell.scene}, {cell.splat}", views)


def _table(cfg: DictConfig, name: str, records: Sequence[Record]) -> tuple[Results, Aims]:
    """A table of the page: its study, its records and its aims."""
    table = cfg.tables[name]
    prefix = f"{name}/"
    table_records = [replace(r, variant=r.variant[len(prefix) :]) for r in records if r.variant.startswith(prefix)]
    scenes = {str(name): tuple(map(str, group.scenes)) for name, group in cfg.groups.items()}
    measured = list(dict.fromkeys(record.scene for record in table_records))
    study = TableDescription(
        name=name,
        title=str(table.title),
        kind="quality",
        about=str(table.about),
        methods={str(method): _method(str(method), choice) for method, choice in table.methods.items()},
        baseline=str(table.baseline),
        metrics=("psnr", "psnr_aligned", "ssim", *cfg.lpips),
        splats=(),
        datasets={
            group: SceneGroup(group, tuple(s for s in names if s in measured)) for group, names in scenes.items()
        },
        seeds=(),
    )
    gains = {scene: _numbers(table.aims[g]) for g, names in scenes.items() for scene in names if g in table.aims}
    return Results(study, table_records), Aims(gains, tuple(table.ahead), _numbers(table.allowed))


def _method(name: str, choice: DictConfig) -> MethodDescription:
    train, enhance = (tuple(map(str, choice.get(key) or ())) for key in ("train", "enhance"))
    about, weights, role = (str(choice.get(key) or "") for key in ("about", "weights", "role"))
    return MethodDescription(name, about, train, weights, enhance, role=role)


def _numbers(values: Mapping[str, float]) -> dict[str, float]:
    return {str(name): float(value) for name, value in values.items()}


def _refuse_unknown(cfg: DictConfig) -> None:
    """Refuse scenes, splats and roles that do not exist; otherwise cells or methods would be left out silently."""
    known_scenes = [str(scene) for group in cfg.groups.values() for scene in group.scenes]
    refuse_unknown("scenes", cfg.scenes, known_scenes)
    refuse_unknown("splats", cfg.splats, cfg.splat_choices)
    for name, table in cfg.tables.items():
        if table.baseline not in table.methods:
            raise InputError(
                f"tables.{name}.baseline", f"is {table.baseline!r}", f"name one of {', '.join(table.methods)}"
            )
        for method, choice in table.methods.items():
            if method != table.baseline and choice.get("role") not in ROLES:
                received = f"is {choice.get('role')!r}"
                raise InputError(f"tables.{name}.methods.{method}.role", received, f"choose {' or '.join(ROLES)}")
