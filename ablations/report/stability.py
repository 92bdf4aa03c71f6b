"""Makes the page of the stability study as Markdown from its records: matrix, counts, refusals, faults, order."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from ablations.stability import catalogue
from ablations.stability.case import PASSES, PRECISIONS, Case
from ablations.stability.judge import FAILED, KIND, REFUSED, WITHIN
from ablations.stability.order import slopes
from ablations.study.markdown import frame, markdown
from ablations.study.plots import category_matrix, convergence
from ablations.study.sections import source_list as sources
from gaussian_enhancer.input_files import read_yaml
from gaussian_enhancer.metrics.records import Record

RAISED = "computed in float32"
"""Outcome of a cell that is within tolerance because the code computes in float32 whatever its inputs."""

COLOURS = {WITHIN: "#4c9a6a", RAISED: "#8fb8de", REFUSED: "#e0b341", FAILED: "#b3261e"}
"""Colour by outcome; colours differ in lightness, so that they can be distinguished in grey."""

SYMBOLS = {WITHIN: "✓", RAISED: "◐", REFUSED: "⊘", FAILED: "✗"}
"""Symbol by outcome; a pass that a case does not have is shown by a dot."""

FAULTS = (
    "Found while the matrix was built, by its cells or by reading what a case reaches. Each is fixed; the case and a "
    "test hold it.\n"
)

ABOUT = """\
Every case of the catalogue is computed in five precisions, forward and backward, and compared with float64 on the very
same numbers: inputs and weights are rounded to the precision first, so that what is measured is the computation and not
what the precision cannot hold. Autocast computes on float32 numbers. A cell ends in one of four ways:

- ✓ finite and within its tolerance of float64;
- ◐ the same, with what half precision cannot do computed in float32 (the result is float32, which says so);
- ⊘ refused with an error that names the cause;
- ✗ failed: not finite, off by more than the tolerance, another error, or no result in time. Cells are computed in a
  process of their own, so that a hang or a crash is a cell.

`gaussian-enhancer stability` computes the matrix and writes this page; `families=[splats]` or `cases=[black_lr_tiny]`
narrow it down. A subset of seconds is a test, and another test reads the committed records and checks that no cell
has failed.
"""


def stability_page(records: Sequence[Record], cases: Sequence[Case], figures: Mapping[str, str], source: str) -> str:
    """The page as Markdown.

    Args:
        records: of the matrix and of the sampler's order.
        cases: the catalogue, with the description of each case.
        figures: links to the diagrams by name: "matrix" and, if it was measured, "order".
        source: address of the records' file, relative to the page.
    """
    cells = [record for record in records if record.kind == KIND]
    order = [record for record in records if record.kind != KIND]
    parts = ["# Stability\n", ABOUT, "## In short\n", markdown(count_table(cells))]
    parts += [f"![The matrix in colour]({figures['matrix']})\n"]
    cases_by_name = {case.name: case for case in cases}
    for family in dict.fromkeys(record.run for record in cells):
        family_cells = [record for record in cells if record.run == family]
        parts += [
            f"## {family.capitalize()}\n",
            _matrix(family_cells, cases_by_name),
            _reasons(family_cells, cases_by_name),
        ]
    if order:
        parts += ["## Order of the latent sampler\n", _order(order, figures["order"])]
    parts += ["## What was refused, and what has failed\n", _refusals_and_failures(cells)]
    lines = [(f"`{fault['case']}`", fault["fault"], fault["remedy"]) for fault in faults()]
    parts += ["## Faults found and fixed\n", FAULTS, markdown(frame(("case", "what happened", "now"), lines))]
    parts += ["## Where the numbers come from\n", sources(records, source)]
    return "\n".join(parts)


def faults() -> list[dict[str, str]]:
    """Faults that were found and fixed: the case that tests each, what happened, and what happens now."""
    return list(read_yaml(Path(catalogue.__file__).with_name("faults.yaml")))


def outcome_of(record: Record) -> str:
    """The outcome of a cell; `RAISED` if it is within tolerance and was computed in float32."""
    return RAISED if record.variant == WITHIN and record.reasons.get("computed") == "float32" else record.variant


def matrix_plot(records: Sequence[Record]) -> str:
    """Plot the matrix as SVG: one row per case, one column per precision and pass.

    Args:
        records: of kind "stability".
    """
    cells = {(f"{r.run}: {r.scene}", f"{r.splat}, {r.view}"): outcome_of(r) for r in records}
    rows = list(dict.fromkeys(row for row, _ in cells))
    columns = [f"{precision.name}, {direction}" for precision in PRECISIONS for direction in PASSES]
    return category_matrix("Stability by case and precision", cells, rows, columns, COLOURS)


def order_plot(records: Sequence[Record]) -> str:
    """Plot the sampler's error over its steps as SVG, one curve per schedule.

    Args:
        records: of kind "sampler order".
    """
    curves: dict[str, list[tuple[float, float]]] = {}
    for record in records:
        steps, error = record.metrics["steps"], record.metrics["error"]
        if steps and error:
            curves.setdefault(record.scene, []).append((steps, error))
    return convergence("Error of the latent sampler over its steps", curves, "steps", "error")


def count_table(cells: Sequence[Record]) -> pd.DataFrame:
    """The number of cells of each outcome, by precision.

    Args:
        cells: records of the matrix.
    """
    counts = Counter((record.splat, outcome_of(record)) for record in cells)
    rows = [
        (precision.name, *(str(counts[precision.name, outcome]) for outcome in SYMBOLS)) for precision in PRECISIONS
    ]
    rows.append(("all", *(str(sum(counts[p.name, outcome] for p in PRECISIONS)) for outcome in SYMBOLS)))
    headings = tuple(f"{symbol} {outcome}" for outcome, symbol in SYMBOLS.items())
    return frame(("precision", *headings), rows)


def _matrix(cells: Sequence[Record], cases_by_name: Mapping[str, Case]) -> str:
    """One line per case: outcomes of forward and backward in each precision, and the errors of float32."""
    by_place = {(record.scene, record.splat, record.view): record for record in cells}
    rows = []
    for name in dict.fromkeys(record.scene for record in cells):
        outcomes = []
        for precision in PRECISIONS:
            pass_records = (by_place.get((name, precision.name, direction)) for direction in PASSES)
            outcomes.append(" ".join("·" if record is None else SYMBOLS[outcome_of(record)] for record in pass_records))
        errors = (by_place.get((name, "float32", direction)) for direction in PASSES)
        about = cases_by_name[name].about if name in cases_by_name else ""
        rows.append(
            (f"`{name}`", about, *outcomes, *("" if r is None else _number(r.metrics["error"]) for r in errors))
        )
    headings = "case", "what", *(precision.name for precision in PRECISIONS), "float32 error", "its gradient's"
    return markdown(frame(headings, rows))


def _number(value: float | None) -> str:
    return "" if value is None else "0" if value == 0 else f"{value:.1e}"


def _reasons(cells: Sequence[Record], cases_by_name: Mapping[str, Case]) -> str:
    """The family's tolerances with their reasons."""
    lines: dict[str, list[str]] = {}
    for name in dict.fromkeys(record.scene for record in cells):
        case = cases_by_name.get(name)
        if case is None:
            continue
        limits = "; ".join(f"{p} {_limits(pair)}" for p, pair in case.tolerance.items())
        lines.setdefault(f"{limits}{f' ({case.why})' if case.why else ''}", []).append(name)
    items = []
    for tolerances, names in lines.items():
        applies_to = "all" if len(names) == len({cell.scene for cell in cells}) else ", ".join(f"`{n}`" for n in names)
        items.append(f"- {applies_to}: {tolerances}\n")
    return "Tolerances, result and gradient:\n\n" + "".join(items)


def _limits(pair: tuple[float, float]) -> str:
    return " and ".join("any finite" if math.isinf(limit) else f"{limit:.2g}" for limit in pair)


def _order(records: Sequence[Record], figure: str) -> str:
    orders = slopes(records)
    rows = []
    for name in dict.fromkeys(record.scene for record in records):
        error_by_steps = {int(r.metrics["steps"] or 0): r.metrics["error"] for r in records if r.scene == name}
        cells = [_number(error_by_steps.get(steps)) for steps in (1, 4, 64, 1000)]
        rows.append((f"`{name}`", *cells, f"{orders[name]:.2f}" if name in orders else ""))
    about = (
        f"{records[0].protocol}. The first two schedules are those in use, the others make the reverse process stiff. "
        "Order 1 means that twice the steps halve the error. The denoiser receives the time as sinusoids with "
        "wavelengths down to 1/64 of the whole, which take hundreds of steps to resolve; it was never trained on the "
        "stiff schedules.\n"
    )
    headings = "schedule", "1 step", "4", "64", "1000", "order at the end"
    return "\n".join([about, f"![Error over steps]({figure})\n", markdown(frame(headings, rows))])


def _refusals_and_failures(cells: Sequence[Record]) -> str:
    """Every reason of a refusal or failure, with its cells."""
    places_by_reason: dict[tuple[str, str], list[str]] = {}
    for record in cells:
        if record.variant in (REFUSED, FAILED):
            key = record.variant, record.reasons.get("outcome", "")
            places_by_reason.setdefault(key, []).append(f"`{record.scene}` {record.splat} {record.view}")
    lines = []
    for (outcome, reason), places in places_by_reason.items():
        remainder = f" and {len(places) - 1} more cells" if len(places) > 1 else ""
        lines.append(f"- {outcome}, {places[0]}{remainder}: {reason}\n")
    return "".join(lines) or "Nothing.\n"
