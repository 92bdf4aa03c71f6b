"""Formats frames and texts as Markdown. Cells are not padded, so a line of a table changes only with its numbers."""

import re
from collections.abc import Iterable, Sequence

import pandas as pd

from gaussian_enhancer.metrics.comparison import Table, format_value

COMMAND = re.compile(r"(python -c '[^']*')")
"""A command in a text, which is printed as code."""


def frame(columns: Sequence[str], lines: Iterable[Sequence[str]]) -> pd.DataFrame:
    """Build a frame of texts from its columns and rows."""
    return pd.DataFrame(list(lines), columns=list(columns), dtype=object)


def markdown(table: pd.DataFrame) -> str:
    """A frame of texts as a Markdown table; pipes in cells are escaped."""
    rows = tuple(tuple(" ".join(cell.split()) for cell in row) for row in table.itertuples(index=False, name=None))
    return Table(tuple(table.columns), rows).markdown()


def escape_markdown(text: str) -> str:
    """Text in one line, with HTML tags and emphasis escaped; commands are code."""
    parts = COMMAND.split(" ".join(text.split()))  # every second part is a command
    escaped = [part.replace("<", "&lt;").replace("*", r"\*") for part in parts]
    escaped[1::2] = [f"`{command}`" for command in parts[1::2]]
    return "".join(escaped)


def format_gain_with_interval(metric: str, gain: float, low: float, high: float) -> str:
    """Format a gain with its interval, if it has one."""
    ends = [format_value(metric, end, signed=True) for end in (low, high)]
    return format_value(metric, gain, signed=True) + (f" [{', '.join(ends)}]" if all(ends) else "")
