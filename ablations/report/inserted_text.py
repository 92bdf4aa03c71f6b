"""Inserts texts that are made from committed records into pages that are written by hand, between marks."""

from collections.abc import Callable
from pathlib import Path

import pandas as pd

from ablations.benchmarks.networks import format_networks
from ablations.report.desk import choices_table, stand_in_table
from ablations.report.readme import converged_table, frozen_test_sentence
from ablations.report.video import flicker_table, read_speed, speed_table
from ablations.scripts.depth import gains_over_raw
from ablations.scripts.diversity import spreads
from ablations.scripts.fingerprints import by_energy
from ablations.study.markdown import markdown
from ablations.study.row_table import read_layout, row_table
from ablations.study.rows import RowFile
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import read_records

PAGES = (
    "README.md",
    "docs/index.md",
    "docs/video.md",
    "docs/results/desk.md",
    "docs/results/fitting.md",
    "docs/results/networks.md",
    "docs/results/simulator.md",
    "docs/results/weights.md",
)
"""Pages with inserted texts."""
BEGIN, END = "<!-- {}: gaussian-enhancer pages write=true -->", "<!-- end -->"
"""Marks around an inserted text; the first names its records."""


def study_table(
    layout: str, derived: Callable[[pd.DataFrame], pd.DataFrame] = lambda rows: rows
) -> Callable[[Path], str]:
    """The function that makes a study's table from a file of its rows.

    Args:
        layout: of ``conf/row_table``.
        derived: adds columns to the frame of all rows (`Study.derived`).
    """
    return lambda path: markdown(row_table(derived(RowFile(path, ()).read()), read_layout(layout)))


TEXTS: dict[str, Callable[[Path], str]] = {
    "docs/results/test.jsonl": lambda path: frozen_test_sentence(read_records(path)),
    "docs/results/convergence.jsonl": lambda path: converged_table(
        RowFile(path, ("method", "scene", "step", "view")).read()
    ),
    "docs/results/video_speed.json": lambda path: speed_table(read_speed(path)),
    "docs/results/flicker_converged.jsonl": lambda path: flicker_table(read_records(path)),
    "docs/results/flicker_path.jsonl": lambda path: flicker_table(read_records(path)),
    "docs/results/networks.jsonl": study_table("networks", format_networks),
    "docs/results/depth.jsonl": study_table("depth", gains_over_raw),
    "docs/results/depth_converged.jsonl": study_table("depth", gains_over_raw),
    "docs/results/splat_kernels.jsonl": study_table("splat_kernels"),
    "docs/results/initialisation.jsonl": study_table("initialisation"),
    "docs/results/fingerprints.jsonl": study_table("fingerprints", by_energy),
    "docs/results/realism_validation.jsonl": study_table("realism"),
    "docs/results/realism_test.jsonl": study_table("realism"),
    "docs/results/diversity.jsonl": study_table("diversity", spreads),
    "docs/results/renders_validation.jsonl": study_table("gains"),
    "docs/results/renders_test.jsonl": study_table("gains"),
    "docs/results/candidates.jsonl": study_table("gains"),
    "docs/results/candidates_22_nov.jsonl": study_table("gains"),
    "docs/results/strength.jsonl": study_table("gains"),
    "docs/results/factors.jsonl": study_table("factors"),
    "docs/results/sampler.jsonl": study_table("sampler"),
    "docs/results/degradation.jsonl": study_table("degradation"),
    "docs/results/tables/desk": stand_in_table,
    "docs/results/tables/desk/mode.jsonl": choices_table,
}
"""What makes a text, by its file or folder of records."""


def fill_page(page: str, folder: Path, name: str | Path) -> str:
    """Replace every inserted text of a page.

    Args:
        page: text of the page.
        folder: the repository, or a copy of its documentation.
        name: of the page, for errors.

    Raises:
        InputError: the page has no marks, or one without the other, or records are missing or damaged.
    """
    found = [records for records in TEXTS if BEGIN.format(records) in page]
    if not found:
        raise InputError(name, "has no place for its figures", f"put {BEGIN.format('RECORDS')} and {END} around them")
    for records in found:
        page = insert_between_marks(page, TEXTS[records](folder / records), BEGIN.format(records), name)
    return page


def insert_between_marks(page: str, new_text: str, begin: str, name: str | Path) -> str:
    """Replace the text between two marks of a page.

    Args:
        page: text of the page.
        new_text: the new text between the marks.
        begin: the first mark; `END` is the second.
        name: of the page, for errors.

    Raises:
        InputError: the page has no such marks.
    """
    before, begin_mark, after_begin = page.partition(begin)
    _, end_mark, after = after_begin.partition(END)
    if not begin_mark or not end_mark:
        raise InputError(name, "has no place for its figures", f"put {begin} and {END} around them")
    return f"{before}{begin}\n{new_text}{END}{after}"
