"""``gaussian-enhancer quality``: every row on every cell, on one page with aims and with what is missing.

Each step is a content-addressed run: a killed study goes on where it stopped, and what changed alone is done again.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from ablations.records.gains import Aims, Study
from ablations.report.quality import Section, quality_page
from ablations.suite.evaluation import StudyCell, measured_row
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.records import MISSING, Record, read_records, write_records
from gaussian_enhancer.runs.instantiate import require

ROLES = ("other", "ours")


def run(cfg: DictConfig) -> float | None:
    """Run the study, or write its page again.

    Args:
        cfg: see ``conf/quality.yaml``.

    Returns:
        Mean gain in colour-aligned PSNR of the last row of ours in the first table over all cells, dB; None where
        it is missing.

    Raises:
        InputError: the configuration names no cell, or an unknown scene or role, or a file cannot be read or written.
    """
    require(cfg)
    console = Console(stderr=True)
    cells = {name: tuple(study_cells(cfg, table)) for name, table in cfg.tables.items()}
    _refuse_unknown(cfg)
    source, page = Path(cfg.records), Path(cfg.markdown)
    if not cfg.records_only:
        write_records(source, [record for name in cells for record in _measured(cfg, str(name), cells[name], console)])
    sections = [_section(cfg, str(name), read_records(source)) for name in cells]
    link = Path(os.path.relpath(source, page.parent)).as_posix()
    write_text(page, quality_page(cfg.title, cfg.about, sections, link))
    console.print(f"{page}, {source}", highlight=False, soft_wrap=True)
    first = sections[0].study
    gain = first.gain(first.cells, first.rows[-1], "psnr_aligned")
    return gain.value if gain.cells else None


def study_cells(cfg: DictConfig, table: DictConfig) -> Iterator[StudyCell]:
    """The cells of a table: its groups' scenes x methods x densities, as far as the table and the user ask for them."""

    def asked(name: str, *choices: Sequence[str] | None) -> bool:
        return all(choice is None or name in choice for choice in choices)

    for name in table.groups:
        group = cfg.groups[name]
        for scene, overrides in group.scenes.items():
            for splat in cfg.splats:
                for density, choice in group.densities.items():
                    kept = asked(scene, cfg.scenes, table.get("scenes")) and asked(density, table.get("densities"))
                    if kept and asked(splat, table.get("splats")):
                        fit = (*overrides, f"splat={splat}", *cfg.fit, *choice.fit)
                        every = table.get("every", choice.every)
                        yield StudyCell(str(scene), f"{splat}/{density}", fit, every, bool(table.get("finer")))


def _measured(cfg: DictConfig, name: str, cells: Sequence[StudyCell], console: Console) -> Iterator[Record]:
    """Records of a table, every row of every cell; a row that cannot be made leaves a record with the reason."""
    rows = cfg.tables[name].rows
    for number, cell in enumerate(cells, 1):
        console.rule(f"{name} {number} of {len(cells)}: {cell.scene}, {cell.splat}", align="left")
        views: set[str] | None = None
        for row, choice in rows.items():
            try:
                found = measured_row(cfg, cell, str(row), choice)
            except InputError as error:
                console.print(f"{row} is missing: {error}", highlight=False, soft_wrap=True)
                found = (missing_record(cell, str(row), str(error)),)
            else:
                views = _agreeing(views, found)
            yield from (replace(record, variant=f"{name}/{row}") for record in found)


def missing_record(cell: StudyCell, row: str, reason: str) -> Record:
    """What stands in the records where a row could not be measured."""
    return Record(MISSING, "", cell.scene, cell.splat, "", row, {}, {"row": reason})


def _agreeing(views: set[str] | None, found: Sequence[Record]) -> set[str]:
    """The views of a row, which must be those of the rows before it."""
    own = {record.view for record in found}
    if views is not None and own != views:
        raise RuntimeError(f"rows were measured on different views, among them {sorted(own ^ views)[0]}")
    return own


def _section(cfg: DictConfig, name: str, records: Sequence[Record]) -> Section:
    """A table's part of the page."""
    table = cfg.tables[name]
    roles = {role: [str(row) for row, choice in table.rows.items() if choice.get("role") == role] for role in ROLES}
    own = [
        replace(record, variant=record.variant.removeprefix(f"{name}/"))
        for record in records
        if record.variant.startswith(f"{name}/")
    ]
    gains = {
        str(scene): _numbers(table.aims[group])
        for group in table.groups
        for scene in cfg.groups[group].scenes
        if group in table.aims
    }
    aims = Aims(gains, tuple(table.ahead), _numbers(table.allowed))
    described = {str(row): _described(choice) for row, choice in table.rows.items()}
    study = Study(own, table.baseline, roles["other"], roles["ours"])
    return Section(table.title, table.about, study, aims, described)


def _described(choice: DictConfig) -> str:
    """What a row is and where its weights come from."""
    words = [str(choice.get("about", ""))]
    if choice.get("weights"):
        words.append(f"weights `{choice.weights}`")
    if choice.get("train"):
        words.append(f"`gaussian-enhancer train {' '.join(choice.train)}`")
    if choice.get("enhance"):
        words.append(f"`{' '.join(choice.enhance)}`")
    return "; ".join(word for word in words if word)


def _numbers(values: Mapping[str, float]) -> dict[str, float]:
    return {str(name): float(value) for name, value in values.items()}


def _refuse_unknown(cfg: DictConfig) -> None:
    """Refuse scenes and roles that do not exist, which would leave cells or rows out without a word."""
    known = [str(scene) for group in cfg.groups.values() for scene in group.scenes]
    for scene in cfg.scenes or ():
        if scene not in known:
            raise InputError("scenes", f"names {scene!r}", f"choose from {', '.join(known)}")
    for name, table in cfg.tables.items():
        if table.baseline not in table.rows:
            raise InputError(
                f"tables.{name}.baseline", f"is {table.baseline!r}", f"name one of {', '.join(table.rows)}"
            )
        for row, choice in table.rows.items():
            if row != table.baseline and choice.get("role") not in ROLES:
                received = f"is {choice.get('role')!r}"
                raise InputError(f"tables.{name}.rows.{row}.role", received, f"choose {' or '.join(ROLES)}")
