"""From a table's records to its printed cells: columns, blocks, marks of the best, what is missing.

Every number is that of `report.dashboard.lines`, so that all reports of a table agree.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence

from ablations.records.description import Table
from ablations.records.results import Results
from ablations.records.statistics import over_scenes_and_seeds
from ablations.report.dashboard.lines import ALL, STATISTICS, Line, Number, table_lines
from ablations.report.rendered_cells import Block, Notes, Piece, Sheet
from ablations.report.significance import Place, Significance, significance
from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER, Record
from gaussian_enhancer.report.quantities import quantities

SPLATS = {"2dgs": "2DGS", "3dgs": "3DGS", "mip_splatting": "Mip-Splatting"}
BY_SCENE = "by scene"
"""Ending of a statistic over scenes and seeds, where the paper's is over runs."""


class Figures:
    """All that a table's reports state, computed once from its records.

    Args:
        table: its description.
        records: its records, in any order.

    Raises:
        InputError: a view was measured twice.
    """

    def __init__(self, table: Table, records: Sequence[Record]) -> None:
        self.table = table
        self.results = Results(table, records)
        found = table_lines(self.results, records)
        self.lines: tuple[Line, ...] = (*found, *self._by_scene(found))
        self.tests: Mapping[Place, Significance] = significance(self.results, found)
        self.blocks: dict[tuple[str, str], list[Line]] = {}
        for line in self.lines:
            self.blocks.setdefault((line.block, line.dataset), []).append(line)
        self.quantities = {quantity.key: quantity for quantity in quantities(set(table.metrics))}
        self.shown = tuple(metric for metric in table.metrics if self._known(metric)) or table.metrics

    def sheet(self) -> Sheet:
        """The printed table."""
        notes = Notes()
        columns = (
            "row",
            *(title for metric in self.shown for title in self._columns(metric)),
            "scenes",
            "seeds",
            "views",
        )
        blocks = tuple(
            Block(self._block_title(key), tuple(self._pieces(line, members, notes) for line in members))
            for key, members in self.blocks.items()
        )
        return Sheet(columns, blocks, notes.texts())

    def best(self, line: Line, metric: str, paper: bool = False) -> bool:
        """Whether a line's value is the best among its block's rows, of at least two; None never is."""
        higher = HIGHER_IS_BETTER[metric]
        among = [self._value(other, metric, paper) for other in self.blocks[line.block, line.dataset]]
        known = [value for value in among if value is not None]
        own = self._value(line, metric, paper)
        if self.table.kind == "repeats" or higher is None or own is None or len(known) < 2:
            return False
        return own == (max(known) if higher else min(known))

    def title(self, line: Line) -> str:
        """A line's row, with the statistic where there is one."""
        row = self.table.rows[line.row].title
        if not line.statistic:
            return row
        return f"{row}, {line.statistic}" if len(self.table.rows) > 2 else line.statistic

    def _known(self, metric: str) -> bool:
        """Whether any cell has a number of its own or of the paper: a column of nothing else is said in the notes."""
        numbers = [line.numbers[metric] for line in self.lines]
        own = [value for n in numbers for value in (n.value, n.gain)]
        papers = [value for n in numbers for value in (n.paper, n.paper_gain)] if self.table.paper else []
        return any(value is not None for value in own + papers)

    def _by_scene(self, lines: Sequence[Line]) -> Iterator[Line]:
        """Lines over scenes and seeds for every line over seeds; of one scene they are the same, and left out."""
        datasets = self.table.datasets
        repeated = [line for line in lines if line.statistic and len(datasets[line.dataset].scenes) > 1]
        for line in repeated:
            scenes = datasets[line.dataset].scenes
            numbers = {}
            for metric in self.table.metrics:
                spread = over_scenes_and_seeds(self.results.gains(line.block, line.row, metric, None, scenes))
                value = getattr(spread, STATISTICS[line.statistic])
                known = value if math.isfinite(value) else None
                numbers[metric] = dataclasses.replace(line.numbers[metric], gain=known, paper_gain=None)
            yield dataclasses.replace(line, statistic=f"{line.statistic} {BY_SCENE}", numbers=numbers)

    def _block_title(self, key: tuple[str, str]) -> str:
        block, dataset = key
        name = SPLATS.get(block, block.upper() if self.results.costs else block)
        if self.results.costs:
            return name
        if dataset == ALL:
            return f"{name}, all datasets" if name else "all datasets"
        title = self.table.datasets[dataset].title
        return f"{title}, {name}" if len(self.table.datasets) > 1 else name

    def _columns(self, metric: str) -> Iterator[str]:
        label, kind = self.quantities[metric].label, self.table.kind
        unit = f", {self.quantities[metric].unit}" if self.quantities[metric].unit else ""
        arrow = {True: " ↑", False: " ↓", None: ""}[HIGHER_IS_BETTER[metric]]
        if kind == "repeats":
            yield f"{label} gain{unit}{arrow}"
        else:
            yield f"{label}{unit}{arrow}"
        if kind in ("quality", "images"):
            yield f"{label} gain [95 %]"
            yield f"{label} p (Holm)"
        if self.table.paper:
            yield f"{label} paper" if kind != "repeats" else f"{label} paper's gain"
            if kind in ("quality", "images"):
                yield f"{label} paper's gain"

    def _pieces(self, line: Line, members: Sequence[Line], notes: Notes) -> tuple[Piece, ...]:
        pieces = [Piece(self.title(line))]
        for metric in self.table.metrics:
            if metric in self.shown:
                pieces += self._cells(line, metric, notes)
                continue
            for told in line.numbers[metric].reasons:
                place, _, reason = told.partition(": ")
                notes.number(self._place(line), f"{place}: {self.quantities[metric].label}: {reason}")
        counts = [(n.scenes, n.seeds, n.views) for metric, n in line.numbers.items() if metric in self.shown]
        return (*pieces, *(Piece(_range(column)) for column in zip(*counts, strict=True)))

    def _cells(self, line: Line, metric: str, notes: Notes) -> Iterator[Piece]:
        number, kind = line.numbers[metric], self.table.kind
        value = number.gain if kind == "repeats" else number.value
        status = tuple(dict.fromkeys(notes.number(self._place(line), reason) for reason in number.reasons))
        if value is None:
            yield Piece("missing", notes=status)
        else:
            text = self._signed(metric, value) if kind == "repeats" else self._written(metric, value)
            yield Piece(text, self.best(line, metric), status)
        if kind in ("quality", "images"):
            yield Piece(self._gain(line, metric, number))
            yield Piece(self._p(line, metric))
        if self.table.paper:
            printed = number.paper_gain if kind == "repeats" else number.paper
            yield Piece(_printed(metric, printed), self.best(line, metric, paper=True))
            if kind in ("quality", "images"):
                yield Piece("" if line.row == self.table.baseline else _printed(metric, number.paper_gain, True))

    def _place(self, line: Line) -> str:
        return " ".join(part for part in (SPLATS.get(line.block, line.block), self.table.rows[line.row].title) if part)

    def _gain(self, line: Line, metric: str, number: Number) -> str:
        if line.row == self.table.baseline:
            return ""
        if number.gain is None:
            return "missing"
        if number.low is None or number.high is None:
            return self._signed(metric, number.gain)
        low, high = (self._signed(metric, end) for end in (number.low, number.high))
        return f"{self._signed(metric, number.gain)} [{low}, {high}]"

    def _p(self, line: Line, metric: str) -> str:
        test = self.tests.get((line.block, line.dataset, line.row, metric))
        if test is None:
            return ""
        return (
            "none" if math.isnan(test.corrected) else f"{test.corrected:.3f}" if test.corrected >= 1e-3 else "< 0.001"
        )

    def _value(self, line: Line, metric: str, paper: bool) -> float | None:
        return line.numbers[metric].paper if paper else line.numbers[metric].value

    def _written(self, metric: str, value: float) -> str:
        return f"{value:.{self.quantities[metric].decimals}f}"

    def _signed(self, metric: str, value: float) -> str:
        return f"{value:+.{max(3, self.quantities[metric].decimals)}f}"


def _range(counts: Sequence[int]) -> str:
    """One number, or the least and the most where metrics differ."""
    return str(counts[0]) if len(set(counts)) == 1 else f"{min(counts)} to {max(counts)}"


def _printed(metric: str, value: float | None, signed: bool = False) -> str:
    """The paper's number with the digits that it was printed with; a dash where it has none."""
    if value is None:
        return "–"
    rounded = round(value, 6)
    if metric in ("milliseconds", "peak_memory_mb"):
        return f"{rounded:g}"
    decimals = max(2 if metric.startswith("psnr") else 3, -_exponent(rounded))
    return f"{rounded:+.{decimals}f}" if signed else f"{rounded:.{decimals}f}"


def _exponent(value: float) -> int:
    """Power of ten of the last digit."""
    _, _, digits = f"{value:.6f}".rstrip("0").partition(".")
    return -len(digits)
