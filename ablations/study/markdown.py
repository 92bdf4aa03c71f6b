"""Formats frames and texts as Markdown. Cells are not padded, so a line of a table changes only with its numbers."""

from collections.abc import Iterable, Sequence

import pandas as pd
from tabulate import DataRow, TableFormat

from gaussian_enhancer.metrics.comparison import format_value

ROW = DataRow("| ", " | ", " |")
FORMAT = TableFormat(
    lineabove=None,
    linebelowheader=lambda widths, alignments: f"| {' | '.join('---' for _ in widths)} |",
    linebetweenrows=None,
    linebelow=None,
    headerrow=ROW,
    datarow=ROW,
    padding=0,
    with_header_hide=None,
)
"""GitHub's table format with cells as wide as their text."""


def frame(columns: Sequence[str], lines: Iterable[Sequence[str]]) -> pd.DataFrame:
    """Build a frame of texts from its columns and rows."""
    return pd.DataFrame(list(lines), columns=list(columns), dtype=object)


def markdown(table: pd.DataFrame) -> str:
    """A frame of texts as a Markdown table; pipes in cells are escaped."""
    if table.empty:
        return f"| {' | '.join(table.columns)} |\n| {' | '.join('---' for _ in table.columns)} |\n"
    escaped = table.map(lambda text: " ".join(text.replace("|", r"\|").split()))
    options = {"disable_numparse": True, "stralign": None, "numalign": None}
    return str(escaped.to_markdown(index=False, tablefmt=FORMAT, **options)) + "\n"


def escape_markdown(text: str) -> str:
    """Text in one line, with HTML tags and emphasis escaped."""
    return " ".join(text.replace("<", "&lt;").replace("*", r"\*").split())


def format_gain_with_interval(metric: str, gain: float, low: float, high: float) -> str:
    """Format a gain with its interval, if it has one."""
    ends = [format_value(metric, end, signed=True) for end in (low, high)]
    return format_value(metric, gain, signed=True) + (f" [{', '.join(ends)}]" if all(ends) else "")
