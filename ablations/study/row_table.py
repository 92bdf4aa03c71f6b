"""A table of a frame of rows, as its layout in ``conf/row_table`` states it: groups of rows, one template a column.

A template is Python's format of the columns' statistics: ``"{psnr.mean:+.2f}"``, ``"{psnr.negatives}"``.
A column without a statistic is the group's first value: ``"{views}"``.
"""

import math
import string
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pandas as pd
from omegaconf import OmegaConf

from ablations.study.markdown import frame as texts
from ablations.study.markdown import markdown
from ablations.study.sample import ScoreSample
from ablations.study.statistics import interval
from gaussian_enhancer.configurations import configurations
from gaussian_enhancer.runs.instantiate import plain

ALL = "all"
"""What the group over all values of a column is called."""
UNKNOWN = "-"
"""What stands for a number that was not measured."""


@dataclass(frozen=True)
class TableLayout:
    """What a study's table shows.

    Args:
        by: headings of the columns by which rows are grouped.
        columns: template by heading; one whose columns were not measured is left out.
        across: template by column, one column of the table for each of its values in order of the alphabet.
        total: a column of ``by``: the groups over all of its values come last.
        ordered: groups are sorted; else they have the order of the rows.
        unknown: what stands for a number that was not measured.
        title: heading of the page.
        about: its text.
        section: column by which the page is divided.
        sections: heading by value of it, in their order.
    """

    by: Mapping[str, str]
    columns: Mapping[str, str]
    across: Mapping[str, str] = field(default_factory=dict)
    total: str = ""
    ordered: bool = False
    unknown: str = UNKNOWN
    title: str = ""
    about: str = ""
    section: str = ""
    sections: Mapping[str, str] = field(default_factory=dict)


def read_layout(name: str) -> TableLayout:
    """A layout of ``conf/row_table``."""
    return TableLayout(**plain(OmegaConf.load(configurations() / "row_table" / f"{name}.yaml")))  # type: ignore[arg-type]


class OptionalNumber(float):
    """A number that may be unknown."""

    def __format__(self, form: str) -> str:
        return UNKNOWN if math.isnan(self) else super().__format__(form)


@dataclass(frozen=True)
class Interval:
    """Ends of a 95% interval; NaN where there are too few rows."""

    low: float
    high: float

    def __format__(self, form: str) -> str:
        return "too few views" if math.isnan(self.low) else f"{self.low:{form}} to {self.high:{form}}"


class Column:
    """One column of a group of rows, with the statistics that a template may name."""

    def __init__(self, values: pd.Series) -> None:
        self.values = values
        self.known = values.dropna()

    def __format__(self, form: str) -> str:
        """The first value."""
        first = self.values.iloc[0]
        return format(OptionalNumber(first) if isinstance(first, float) else first, form)

    @property
    def mean(self) -> OptionalNumber:
        """Of the values that are known."""
        return OptionalNumber(self.known.mean())

    @property
    def median(self) -> OptionalNumber:
        """Likewise."""
        return OptionalNumber(self.known.median())

    @property
    def min(self) -> OptionalNumber:
        """Likewise."""
        return OptionalNumber(self.known.min())

    @property
    def max(self) -> OptionalNumber:
        """Likewise."""
        return OptionalNumber(self.known.max())

    @property
    def count(self) -> int:
        """How many values are known."""
        return len(self.known)

    @property
    def positives(self) -> str:
        """How many are above 0, of how many."""
        return self._share(self.known > 0)

    @property
    def negatives(self) -> str:
        """How many are below 0, of how many."""
        return self._share(self.known < 0)

    @property
    def interval(self) -> Interval:
        """Of the mean over rows."""
        values = {str(place): float(value) for place, value in enumerate(self.known)}
        pair = ("all", "all")
        return Interval(*interval(ScoreSample((pair,), (None,), {(pair, None): values})))

    def _share(self, counted: pd.Series) -> str:
        return f"{int(counted.sum())} of {len(counted)}" if len(counted) else UNKNOWN


def row_table(frame: pd.DataFrame, layout: TableLayout) -> pd.DataFrame:
    """The table as texts, a line a group.

    Args:
        frame: rows.
        layout: what is shown.
    """
    columns = {head: template for head, template in layout.columns.items() if _names(template) & set(frame.columns)}
    across = [(name, value, text) for name, text in layout.across.items() for value in sorted(frame[name].unique())]
    heads = (*layout.by.values(), *columns, *(str(value) for _, value, _ in across))
    lines = []
    for keys, group in _groups(frame, layout):
        cells = [filled(template, group) for template in columns.values()]
        cells += [filled(text, group[group[name] == value]) for name, value, text in across]
        lines.append([*map(str, keys), *(layout.unknown if cell == UNKNOWN else cell for cell in cells)])
    return texts(heads, lines)


def page(frame: pd.DataFrame, layout: TableLayout, above: Sequence[str] = (), below: Sequence[str] = ()) -> str:
    """The page as Markdown: title, text, and a table a section.

    Args:
        frame: rows.
        layout: what is shown.
        above: parts above the tables.
        below: parts below them.
    """
    parts = [f"# {layout.title}", layout.about, *above]
    for value, title in layout.sections.items():
        own = frame[frame[layout.section] == value]
        parts += [f"## {title}", markdown(row_table(own, layout))] if len(own) else []
    return "\n\n".join([*parts, *below]) + "\n"


def filled(template: str, group: pd.DataFrame) -> str:
    """A template with the statistics of a group of rows; unknown where there are none."""
    return template.format_map({name: Column(group[name]) for name in _names(template)}) if len(group) else UNKNOWN


def _groups(frame: pd.DataFrame, layout: TableLayout) -> Iterator[tuple[tuple[Any, ...], pd.DataFrame]]:
    names = list(layout.by)
    yield from frame.groupby(names, sort=layout.ordered)
    if layout.total:
        yield from frame.assign(**{layout.total: ALL}).groupby(names, sort=layout.ordered)


def _names(template: str) -> set[str]:
    """The columns that a template names."""
    return {name.partition(".")[0] for _, name, _, _ in string.Formatter().parse(template) if name}
