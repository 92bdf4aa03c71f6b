"""Formats a frame of rows as a table, by a layout of ``conf/row_table``: groups of rows, and one template per column.

A template is a Python format string of the statistics of columns: ``"{psnr.mean:+.2f}"``, ``"{psnr.negatives}"``.
A column without a statistic gives the group's first value: ``"{views}"``.
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
from gaussian_enhancer.runs.instantiate import plain_values

ALL = "all"
"""Name of the group over all values of a column."""
UNKNOWN = "-"
"""Text of a number that was not measured."""


@dataclass(frozen=True)
class TableLayout:
    """The layout of a study's table and page.

    Args:
        by: headings, by the columns that rows are grouped by.
        columns: template by heading; a template is left out if none of its columns was measured.
        across: template by column of the frame; the table has one column for each of its values, sorted.
        total: a column of ``by``; groups over all of its values are appended.
        ordered: whether groups are sorted; else they have the order of the rows.
        unknown: text of a number that was not measured.
        title: heading of the page.
        about: text below the heading.
        section: column by which the page is divided into sections.
        sections: heading by value of that column, in the order of the page.
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
    """Read a layout of ``conf/row_table``."""
    return TableLayout(**plain_values(OmegaConf.load(configurations() / "row_table" / f"{name}.yaml")))  # type: ignore[arg-type]


class OptionalNumber(float):
    """A number that is NaN, and formatted as `UNKNOWN`, if it was not measured."""

    def __format__(self, form: str) -> str:
        return UNKNOWN if math.isnan(self) else super().__format__(form)


@dataclass(frozen=True)
class Interval:
    """Ends of a 95% interval; NaN for too few rows."""

    low: float
    high: float

    def __format__(self, form: str) -> str:
        return "too few views" if math.isnan(self.low) else f"{self.low:{form}} to {self.high:{form}}"


class Column:
    """One column of a group of rows, with the statistics that templates can use. Unknown values are left out."""

    def __init__(self, values: pd.Series) -> None:
        self.values = values
        self.known = values.dropna()

    def __format__(self, form: str) -> str:
        """Format the first value."""
        first_value = self.values.iloc[0]
        return format(OptionalNumber(first_value) if isinstance(first_value, float) else first_value, form)

    @property
    def mean(self) -> OptionalNumber:
        """Mean of the known values."""
        return OptionalNumber(self.known.mean())

    @property
    def median(self) -> OptionalNumber:
        """Median of the known values."""
        return OptionalNumber(self.known.median())

    @property
    def min(self) -> OptionalNumber:
        """Minimum of the known values."""
        return OptionalNumber(self.known.min())

    @property
    def max(self) -> OptionalNumber:
        """Maximum of the known values."""
        return OptionalNumber(self.known.max())

    @property
    def count(self) -> int:
        """Number of known values."""
        return len(self.known)

    @property
    def positives(self) -> str:
        """Number of values above 0, and of all known values."""
        return self._share(self.known > 0)

    @property
    def negatives(self) -> str:
        """Number of values below 0, and of all known values."""
        return self._share(self.known < 0)

    @property
    def interval(self) -> Interval:
        """Interval of the mean over rows."""
        values = {str(place): float(value) for place, value in enumerate(self.known)}
        pair = ("all", "all")
        return Interval(*interval(ScoreSample((pair,), (None,), {(pair, None): values})))

    def _share(self, counted: pd.Series) -> str:
        return f"{int(counted.sum())} of {len(counted)}" if len(counted) else UNKNOWN


def row_table(frame: pd.DataFrame, layout: TableLayout) -> pd.DataFrame:
    """The table as a frame of texts, one line per group.

    Args:
        frame: rows.
        layout: of the table.
    """
    columns = {
        heading: template for heading, template in layout.columns.items() if _names(template) & set(frame.columns)
    }
    across = [(name, value, text) for name, text in layout.across.items() for value in sorted(frame[name].unique())]
    headings = (*layout.by.values(), *columns, *(str(value) for _, value, _ in across))
    lines = []
    for keys, group in _groups(frame, layout):
        cells = [fill_template(template, group) for template in columns.values()]
        cells += [fill_template(text, group[group[name] == value]) for name, value, text in across]
        lines.append([*map(str, keys), *(layout.unknown if cell == UNKNOWN else cell for cell in cells)])
    return texts(headings, lines)


def page(frame: pd.DataFrame, layout: TableLayout, above: Sequence[str] = (), below: Sequence[str] = ()) -> str:
    """The page as Markdown: title, text, and one table per section.

    Args:
        frame: rows.
        layout: of the page.
        above: parts above the tables.
        below: parts below them.
    """
    parts = [f"# {layout.title}", layout.about, *above, *section_tables(frame, layout), *below]
    return "\n\n".join(parts) + "\n"


def section_tables(frame: pd.DataFrame, layout: TableLayout, suffix: str = "") -> list[str]:
    """Heading and table of every section that has rows; ``suffix`` is appended to the headings."""
    parts = []
    for value, title in layout.sections.items():
        section_rows = frame[frame[layout.section] == value]
        parts += [f"## {title}{suffix}", markdown(row_table(section_rows, layout))] if len(section_rows) else []
    return parts


def fill_template(template: str, group: pd.DataFrame) -> str:
    """Fill a template with the statistics of a group of rows; `UNKNOWN` for a group without rows."""
    return template.format_map({name: Column(group[name]) for name in _names(template)}) if len(group) else UNKNOWN


def _groups(frame: pd.DataFrame, layout: TableLayout) -> Iterator[tuple[tuple[Any, ...], pd.DataFrame]]:
    names = list(layout.by)
    yield from frame.groupby(names, sort=layout.ordered)
    if layout.total:
        yield from frame.assign(**{layout.total: ALL}).groupby(names, sort=layout.ordered)


def _names(template: str) -> set[str]:
    """The columns that a template uses."""
    return {name.partition(".")[0] for _, name, _, _ in string.Formatter().parse(template) if name}
