"""The study engine: parts are measured one after the other, rows are kept, and reports are made of them.

A study is a configuration ``conf/JOB.yaml`` and a module that says what is measured: ``run = job(study)``, where
``study(cfg, device)`` gives a `Study`. A layout of the group ``row_table`` says what its table and its page show. A
study whose page is more than tables writes it by ``report``.

A study that was killed goes on where it stopped: the same command finds the parts that were measured in a folder beside
the records. At the end they are added to the records, in place of what was measured there before.
"""

import json
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import pandas as pd
import torch
from omegaconf import DictConfig

from ablations.study.markdown import markdown
from ablations.study.row_table import TableLayout, page, row_table
from ablations.study.rows import Measurement, RowFile, frame_of, line_of, stated
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.records import MISSING
from gaussian_enhancer.runs.instantiate import plain, require
from gaussian_enhancer.runs.run import digest_of
from gaussian_enhancer.runs.runtime import start

Part = TypeVar("Part")


NO_EFFECT = ("row_table", "page", "runtime", "output", "records_only")
"""Options that change nothing of what is measured."""


@dataclass(frozen=True)
class Study(Generic[Part]):
    """What a study measures.

    Args:
        parts: runs, scenes, names of methods or what else is measured at a time, each usable and told from others by
            its text; none: reports are made of the records alone.
        measure: gives the measurements of a part.
        keys: columns that say what was measured; measuring it again replaces its rows.
        columns: further ones that records must have.
        option: of the job, by which it measures.
        records: their file; None: the option ``records`` names it.
        whole: the records are those of this command alone, in place of all that the file held. Parts are not kept
            beside it: they are runs of their own, which are found again, or must be measured in one process.
        derived: adds columns to the frame of all rows.
        above: parts of the page above its tables, from that frame and the page's path.
        below: parts below them, from the page's path.
        report: writes what is made of the records in place of the table and its page; its result is the job's.
    """

    parts: Sequence[Part]
    measure: Callable[[Part], Iterable[Measurement]]
    keys: tuple[str, ...] = ("run", "view", "variant")
    columns: tuple[str, ...] = ()
    option: str = "runs"
    records: Path | None = None
    whole: bool = False
    derived: Callable[[pd.DataFrame], pd.DataFrame] = lambda frame: frame
    above: Callable[[pd.DataFrame, Path], Sequence[str]] = lambda frame, page: ()
    below: Callable[[Path], Sequence[str]] = lambda page: ()
    report: Callable[[], float | None] | None = None

    def file(self, option: str | Path | None) -> RowFile | None:
        """The file of its records.

        Args:
            option: what the option ``records`` names.
        """
        path = self.records or option
        return RowFile(Path(path), self.keys, self.columns, self.option) if path else None


def job(
    make: Callable[[DictConfig, torch.device], Study[Any] | Sequence[Study[Any]]],
) -> Callable[[DictConfig], float | None]:
    """The ``run`` of a study's job.

    Args:
        make: gives the study that a configuration asks for, or several; the last one reports on the records of all.
    """

    def run(cfg: DictConfig) -> float | None:
        """Measure, keep the rows, and report: by default the table, and a page of it where one is asked for."""
        require(cfg)
        made = make(cfg, start(cfg.runtime))
        *others, study = made if isinstance(made, Sequence) else (made,)
        digest = digest_of({name: value for name, value in plain(cfg).items() if name not in NO_EFFECT})
        reported = (study,) if study.report is not None else ()
        for one in (*others, *reported):
            if file := one.file(cfg.get("records")):
                add(one, file, digest)
        if study.report is not None:
            return study.report()
        frame, layout = study.derived(measured(study, cfg.records, digest)), TableLayout(**plain(cfg.row_table))
        if cfg.get("page"):
            path = Path(cfg.page)
            write_text(path, page(frame, layout, study.above(frame, path), study.below(path)))
        print(markdown(row_table(frame, layout)), end="")
        return None

    return run


def measured(study: Study[Any], records: str | Path | None, digest: str = "") -> pd.DataFrame:
    """Measure every part; the frame of all rows.

    Args:
        study: what is measured.
        records: file to which the rows are added; the frame has what it held before as well. None keeps none.
        digest: of the command; the same one goes on with the parts that it lacks.

    Raises:
        InputError: there is nothing to report, or the file holds something else or cannot be written.
    """
    file = study.file(records)
    if file is None:
        frame = frame_of(stated(one) for part in study.parts for one in study.measure(part))
    else:
        add(study, file, digest)
        frame = file.read()
    if frame.empty:
        raise InputError("records", "hold no row", f"measure, with {study.option}=")
    return frame


def add(study: Study[Any], file: RowFile, digest: str) -> None:
    """Measure every part and add the rows to the records.

    Args:
        study: what is measured.
        file: of its records.
        digest: of the command; the same one goes on with the parts that it lacks.

    Raises:
        InputError: nothing could be measured, or the file holds something else or cannot be written.
    """
    if study.whole:
        if study.parts:
            lines = [line_of(stated(one)) for part in study.parts for one in study.measure(part)]
            write_text(file.path, "".join(f"{line}\n" for line in lines))
        return
    file.held()  # a file of something else is refused before anything is measured
    folder = file.path.with_name(f"{file.path.name}.{digest}.parts")
    lines = []
    for part in study.parts:
        kept = folder / f"{digest_of({'part': str(part)})}.jsonl"
        if not kept.is_file():
            write_text(kept, "\n".join(line_of(stated(one)) for one in study.measure(part)))
        lines += filter(None, kept.read_text(encoding="utf-8").split("\n"))  # splitlines would cut names
    shutil.rmtree(folder, ignore_errors=True)
    missing = [one["reasons"].get("row", "") for one in map(json.loads, lines) if one.get("kind") == MISSING]
    if lines and len(missing) == len(lines):
        raise InputError(study.option, f"name nothing that could be measured ({missing[0]})", "make what is missing")
    file.add_lines(lines)
