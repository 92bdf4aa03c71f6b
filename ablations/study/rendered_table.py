"""Turns a study's records into the text of its table: columns, blocks, best values, notes on missing values.

All numbers come from `study.lines`, so that all reports of a study agree.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from ablations.study.description import TableDescription
from ablations.study.lines import ALL, STATISTICS, Line, Number, table_lines
from ablations.study.results import Results
from ablations.study.significance import Significance, TestKey, significance
from ablations.study.statistics import spread_over_scenes_and_seeds
from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER, Record
from gaussian_enhancer.report.quantities import quantities

SPLATS = {"2dgs": "2DGS", "3dgs": "3DGS", "mip_splatting": "Mip-Splatting"}
BY_SCENE = "by scene"
"""Suffix of a statistic over scenes and seeds, unlike the paper's, which are over runs."""


@dataclass(frozen=True)
class Cell:
    """One cell of a rendered table.

    Args:
        text: plain text.
        best: whether it is the best of its column in its block.
        notes: numbers of the notes that it refers to.
    """

    text: str
    best: bool = False
    notes: tuple[int, ...] = ()


@dataclass(frozen=True)
class RenderedTable:
    """A table's text, independent of Markdown or LaTeX.

    Args:
        blocks: heading and frame of `Cell`; arrows in the columns' names show in which direction a metric is better.
        notes: reasons of missing values; the first has the number 1.
    """

    blocks: tuple[tuple[str, pd.DataFrame], ...]
    notes: tuple[str, ...]


class Notes:
    """Numbered reasons of missing values, each with the methods, scenes and seeds that it applies to."""

    def __init__(self) -> None:
        self._places: dict[str, dict[str, dict[str, None]]] = {}

    def number(self, where: str, reason_text: str) -> int:
        """Register a reason and return its number, counted from 1.

        Args:
            where: block and method.
            reason_text: a text of `Number.reasons`: scene and seed, a colon, the reason.
        """
        scene_and_seed, separator, reason = reason_text.partition(": ")
        reason, scene_and_seed = (reason, scene_and_seed) if separator else (reason_text, "")
        self._places.setdefault(reason, {}).setdefault(where, {})[scene_and_seed] = None
        return list(self._places).index(reason) + 1

    def texts(self) -> tuple[str, ...]:
        """The notes in the order of their numbers."""
        return tuple(f"{reason}; in {_list_methods(methods)}" for reason, methods in self._places.items())


def _list_methods(methods: Mapping[str, Mapping[str, None]]) -> str:
    """List methods, each with its scenes and seeds in brackets."""
    places = {method: "; ".join(filter(None, applies_to)) for method, applies_to in methods.items()}
    return ", ".join(f"{method} ({applies_to})" if applies_to else method for method, applies_to in places.items())


class StudyTable:
    """All numbers that the reports of a table state, computed once from its records.

    Args:
        study: its description.
        records: its records, in any order.

    Raises:
        InputError: a view was measured twice.
    """

    def __init__(self, study: TableDescription, records: Sequence[Record]) -> None:
        self.study = study
        self.results = Results(study, records)
        lines_over_seeds = table_lines(self.results, records)
        self.lines: tuple[Line, ...] = (*lines_over_seeds, *self._by_scene(lines_over_seeds))
        self.tests: Mapping[TestKey, Significance] = significance(self.results, lines_over_seeds)
        self.blocks: dict[tuple[str, str], list[Line]] = {}
        for line in self.lines:
            self.blocks.setdefault((line.block, line.dataset), []).append(line)
        self.quantities = {quantity.key: quantity for quantity in quantities(set(study.metrics))}
        self.shown_metrics = tuple(metric for metric in study.metrics if self._has_value(metric)) or study.metrics

    def rendered(self) -> RenderedTable:
        """The table's text."""
        notes = Notes()
        columns = ["method", *(title for metric in self.shown_metrics for title in self._columns(metric))]
        columns += ["scenes", "seeds", "views"]
        blocks = tuple(
            (self._block_title(key), pd.DataFrame([self._cells(line, notes) for line in lines], columns=columns))
            for key, lines in self.blocks.items()
        )
        return RenderedTable(blocks, notes.texts())

    def best(self, line: Line, metric: str, paper: bool = False) -> bool:
        """Whether a line's value is the best among the methods of its block, if at least two have a value."""
        higher = HIGHER_IS_BETTER[metric]
        values = [self._value(other, metric, paper) for other in self.blocks[line.block, line.dataset]]
        known_values = [value for value in values if value is not None]
        value_of_line = self._value(line, metric, paper)
        if self.study.kind == "repeats" or higher is None or value_of_line is None or len(known_values) < 2:
            return False
        return value_of_line == (max(known_values) if higher else min(known_values))

    def title(self, line: Line) -> str:
        """A line's method, with the statistic if there is one."""
        method = self.study.methods[line.method].title
        if not line.statistic:
            return method
        return f"{method}, {line.statistic}" if len(self.study.methods) > 2 else line.statistic

    def _has_value(self, metric: str) -> bool:
        """Whether any cell of a metric has a number, ours or the paper's; a metric without one appears in the notes."""
        numbers = [line.numbers[metric] for line in self.lines]
        measured_values = [value for n in numbers for value in (n.value, n.gain)]
        paper_values = [value for n in numbers for value in (n.paper, n.paper_gain)] if self.study.paper else []
        return any(value is not None for value in measured_values + paper_values)

    def _by_scene(self, lines: Sequence[Line]) -> Iterator[Line]:
        """A line over scenes and seeds for every line over seeds; left out for one scene, where both are equal."""
        datasets = self.study.datasets
        repeated = [line for line in lines if line.statistic and len(datasets[line.dataset].scenes) > 1]
        for line in repeated:
            scenes = datasets[line.dataset].scenes
            numbers = {}
            for metric in self.study.metrics:
                spread = spread_over_scenes_and_seeds(self.results.gains(line.block, line.method, metric, None, scenes))
                value = getattr(spread, STATISTICS[line.statistic])
                gain = value if math.isfinite(value) else None
                numbers[metric] = dataclasses.replace(line.numbers[metric], gain=gain, paper_gain=None)
            yield dataclasses.replace(line, statistic=f"{line.statistic} {BY_SCENE}", numbers=numbers)

    def _block_title(self, key: tuple[str, str]) -> str:
        block, dataset = key
        name = SPLATS.get(block, block.upper() if self.results.costs else block)
        if self.results.costs:
            return name
        if dataset == ALL:
            return f"{name}, all datasets" if name else "all datasets"
        title = self.study.datasets[dataset].title
        return f"{title}, {name}" if len(self.study.datasets) > 1 else name

    def _columns(self, metric: str) -> Iterator[str]:
        label, kind = self.quantities[metric].label, self.study.kind
        unit = f", {self.quantities[metric].unit}" if self.quantities[metric].unit else ""
        arrow = {True: " ↑", False: " ↓", None: ""}[HIGHER_IS_BETTER[metric]]
        if kind == "repeats":
            yield f"{label} gain{unit}{arrow}"
        else:
            yield f"{label}{unit}{arrow}"
        if kind in ("quality", "images"):
            yield f"{label} gain [95 %]"
            yield f"{label} p (Holm)"
        if self.study.paper:
            yield f"{label} paper" if kind != "repeats" else f"{label} paper's gain"
            if kind in ("quality", "images"):
                yield f"{label} paper's gain"

    def _cells(self, line: Line, notes: Notes) -> list[Cell]:
        cells = [Cell(self.title(line))]
        for metric in self.study.metrics:
            if metric in self.shown_metrics:
                cells += self._metric_cells(line, metric, notes)
                continue
            for reason_text in line.numbers[metric].reasons:
                scene_and_seed, _, reason = reason_text.partition(": ")
                notes.number(self._place(line), f"{scene_and_seed}: {self.quantities[metric].label}: {reason}")
        counts = [(n.scenes, n.seeds, n.views) for metric, n in line.numbers.items() if metric in self.shown_metrics]
        return [*cells, *(Cell(_range(column)) for column in zip(*counts, strict=True))]

    def _metric_cells(self, line: Line, metric: str, notes: Notes) -> Iterator[Cell]:
        number, kind = line.numbers[metric], self.study.kind
        value = number.gain if kind == "repeats" else number.value
        note_numbers = tuple(dict.fromkeys(notes.number(self._place(line), reason) for reason in number.reasons))
        if value is None:
            yield Cell("missing", notes=note_numbers)
        else:
            text = self._signed(metric, value) if kind == "repeats" else self._written(metric, value)
            yield Cell(text, self.best(line, metric), note_numbers)
        if kind in ("quality", "images"):
            yield Cell(self._gain(line, metric, number))
            yield Cell(self._p(line, metric))
        if self.study.paper:
            printed = number.paper_gain if kind == "repeats" else number.paper
            yield Cell(_format_paper_value(metric, printed), self.best(line, metric, paper=True))
            if kind in ("quality", "images"):
                yield Cell(
                    "" if line.method == self.study.baseline else _format_paper_value(metric, number.paper_gain, True)
                )

    def _place(self, line: Line) -> str:
        return f"{SPLATS.get(line.block, line.block)} {self.study.methods[line.method].title}".strip()

    def _gain(self, line: Line, metric: str, number: Number) -> str:
        if line.method == self.study.baseline:
            return ""
        if number.gain is None:
            return "missing"
        if number.low is None or number.high is None:
            return self._signed(metric, number.gain)
        low, high = (self._signed(metric, end) for end in (number.low, number.high))
        return f"{self._signed(metric, number.gain)} [{low}, {high}]"

    def _p(self, line: Line, metric: str) -> str:
        test = self.tests.get((line.block, line.dataset, line.method, metric))
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
    """One number, or the minimum and maximum if metrics differ."""
    return str(counts[0]) if len(set(counts)) == 1 else f"{min(counts)} to {max(counts)}"


def _format_paper_value(metric: str, value: float | None, signed: bool = False) -> str:
    """The paper's number with the printed digits; a dash if it has none."""
    if value is None:
        return "–"
    rounded = round(value, 6)
    if metric in ("milliseconds", "peak_memory_mb"):
        return f"{rounded:g}"
    decimals = max(2 if metric.startswith("psnr") else 3, -_exponent(rounded))
    return f"{rounded:+.{decimals}f}" if signed else f"{rounded:.{decimals}f}"


def _exponent(value: float) -> int:
    """Power of ten of the last non-zero digit."""
    _, _, digits = f"{value:.6f}".rstrip("0").partition(".")
    return -len(digits)
