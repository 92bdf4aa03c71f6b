"""The study engine: measures a study part by part, stores the rows, and makes reports from them.

A study is a configuration ``conf/JOB.yaml`` and a module that defines what is measured: ``run = job(study)``, where
``study(cfg, device)`` returns a `Study`. A layout of the group ``row_table`` defines its table and page. A study whose
page is more than tables writes it by ``report``.

A killed study resumes: the same command finds the parts that were already measured in a folder beside the records. At
the end their rows are added to the records and replace rows with the same keys.
"""

import json
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import pandas as pd
import torch
from omegaconf import DictConfig, OmegaConf

from ablations.study.markdown import markdown
from ablations.study.row_table import TableLayout, page, row_table
from ablations.study.rows import Measurement, RowFile, frame_of, line_of, with_provenance
from gaussian_enhancer.configurations import configurations
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.records import MISSING
from gaussian_enhancer.runs.instantiate import plain_values, require
from gaussian_enhancer.runs.run import digest_of
from gaussian_enhancer.runs.runtime import start

Part = TypeVar("Part")


NO_EFFECT = ("row_table", "page", "runtime", "output", "records_only")
"""Options that do not affect measurements, and are left out of the command's digest."""


@dataclass(frozen=True)
class Study(Generic[Part]):
    """Definition of a study's measurements and reports.

    Args:
        parts: units that are measured one at a time, for instance runs, scenes or names of methods; their texts must
            differ. If empty, reports are made from the existing records alone.
        measure: returns the measurements of a part.
        keys: columns that identify a measurement; a new one replaces rows with the same keys.
        columns: further columns that records must have.
        option: the job's option that selects what is measured, for error messages.
        records: file of the records; None to use the option ``records``.
        replaces_file: whether the records of this command replace the whole file. Parts are then not cached beside it:
            they are content-addressed runs, which are found again, or must be measured in one process.
        derived: adds columns to the frame of all rows.
        above: returns the page's text above its tables, from that frame and the page's path.
        below: returns the page's text below its tables, from the page's path.
        report: writes reports from the records in place of the table and its page; its result is the job's result.
    """

    parts: Sequence[Part]
    measure: Callable[[Part], Iterable[Measurement]]
    keys: tuple[str, ...] = ("run", "view", "variant")
    columns: tuple[str, ...] = ()
    option: str = "runs"
    records: Path | None = None
    replaces_file: bool = False
    derived: Callable[[pd.DataFrame], pd.DataFrame] = lambda frame: frame
    above: Callable[[pd.DataFrame, Path], Sequence[str]] = lambda frame, page: ()
    below: Callable[[Path], Sequence[str]] = lambda page: ()
    report: Callable[[], float | None] | None = None

    def file(self, option: str | Path | None) -> RowFile | None:
        """The file of the study's records; None if there is none.

        Args:
            option: value of the option ``records``.
        """
        path = self.records or option
        return RowFile(Path(path), self.keys, self.columns, self.option) if path else None


def refuse_narrowed(name: str, cfg: DictConfig, narrowing: str, place: str, remedy: str) -> None:
    """Refuse an option that measures a part where it would replace the job's committed records of everything.

    Args:
        name: of the job; its file states where the records are by default.
        cfg: the job's configuration, composed.
        narrowing: option that names what is measured; its default is all.
        place: option that names the place of the records.
        remedy: options that write elsewhere.

    Raises:
        InputError: the option names a part, and the records are at their default place.
    """
    defaults = OmegaConf.load(configurations() / f"{name}.yaml")
    default = OmegaConf.select(defaults, place)
    is_narrowed = OmegaConf.select(cfg, narrowing) != OmegaConf.select(defaults, narrowing)
    if is_narrowed and Path(cfg[place]).resolve() == Path(default).resolve():
        raise InputError(narrowing, f"names a part, but all records in {default} would be replaced", f"add {remedy}")


def job(
    make: Callable[[DictConfig, torch.device], Study[Any] | Sequence[Study[Any]]],
) -> Callable[[DictConfig], float | None]:
    """Make the function ``run`` of a study's job.

    Args:
        make: returns the study of a configuration, or several; the last one reports on the records of all.
    """

    def run(cfg: DictConfig) -> float | None:
        """Measure, store the rows, and report: by default print the table, and write a page if one is asked for."""
        require(cfg)
        studies = make(cfg, start(cfg.runtime))
        *other_studies, study = studies if isinstance(studies, Sequence) else (studies,)
        digest = digest_of({name: value for name, value in plain_values(cfg).items() if name not in NO_EFFECT})
        with_report = (study,) if study.report is not None else ()
        for measured_study in (*other_studies, *with_report):
            if file := measured_study.file(cfg.get("records")):
                measure_and_add(measured_study, file, digest)
        if study.report is not None:
            return study.report()
        frame = study.derived(measure_study(study, cfg.records, digest))
        layout = TableLayout(**plain_values(cfg.row_table))
        if cfg.get("page"):
            path = Path(cfg.page)
            write_text(path, page(frame, layout, study.above(frame, path), study.below(path)))
        print(markdown(row_table(frame, layout)), end="")
        return None

    return run


def measure_study(study: Study[Any], records: str | Path | None, digest: str = "") -> pd.DataFrame:
    """Measure every part; returns the frame of all rows.

    Args:
        study: what is measured.
        records: file to which the rows are added; the frame then also has the rows of earlier commands. None to store
            nothing.
        digest: of the command; a command with the same digest resumes with the parts that were not measured.

    Raises:
        InputError: there is no row, or the file is not a file of these records or cannot be written.
    """
    file = study.file(records)
    if file is None:
        frame = frame_of(with_provenance(measurement) for part in study.parts for measurement in study.measure(part))
    else:
        measure_and_add(study, file, digest)
        frame = file.read()
    if frame.empty:
        raise InputError("records", "hold no row", f"measure, with {study.option}=")
    return frame


def measure_and_add(study: Study[Any], file: RowFile, digest: str = "") -> None:
    """Measure every part and add the rows to the records.

    Args:
        study: what is measured.
        file: of its records.
        digest: of the command; a command with the same digest resumes with the parts that were not measured.

    Raises:
        InputError: nothing could be measured, or the file is not a file of these records or cannot be written.
    """
    if study.replaces_file:
        if study.parts:
            lines = [line_of(with_provenance(row)) for part in study.parts for row in study.measure(part)]
            write_text(file.path, "".join(f"{line}\n" for line in lines))
        return
    file.read_or_empty()  # refuses a wrong file before anything is measured
    folder = file.path.with_name(f"{file.path.name}.{digest}.parts")
    lines = []
    for part in study.parts:
        part_file = folder / f"{digest_of({'part': str(part)})}.jsonl"
        if not part_file.is_file():
            write_text(part_file, "\n".join(line_of(with_provenance(row)) for row in study.measure(part)))
        # splitlines would also split at other line separators within names
        lines += filter(None, part_file.read_text(encoding="utf-8").split("\n"))
    shutil.rmtree(folder, ignore_errors=True)
    missing = [row["reasons"].get("row", "") for row in map(json.loads, lines) if row.get("kind") == MISSING]
    if lines and len(missing) == len(lines) and study.report is None:  # a report of its own shows what is missing
        raise InputError(study.option, f"name nothing that could be measured ({missing[0]})", "make what is missing")
    file.add_lines(lines)
