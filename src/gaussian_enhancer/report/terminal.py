"""The numbers of a report as a table for the terminal."""

import statistics
from collections.abc import Sequence

from rich import box
from rich.table import Table
from rich.text import Text

from gaussian_enhancer.report.compared import ComparedView
from gaussian_enhancer.report.quantities import Quantity
from gaussian_enhancer.report.summary import gain_of, measured_quantities, summarise, worst_view

STYLES = {"better": "green", "worse": "red", "same": "dim"}


def comparison_table(views: Sequence[ComparedView], title: str = "") -> Table:
    """Table of raw against enhanced: a row per view, a column per metric, and the mean in the last row.

    The table fits into 80 columns.

    Args:
        views: the compared views.
        title: title above the table.
    """
    quantities = [
        quantity for quantity in measured_quantities(views) if any(gain_of(v, quantity.key) is not None for v in views)
    ]
    summaries = [summarise(views, quantity) for quantity in quantities]
    worst = worst_view(summaries)
    table = Table(title=title or None, show_footer=True, title_justify="left")
    table.box, table.show_lines = box.SIMPLE_HEAD, True
    table.add_column("view", footer="mean", no_wrap=True)
    for quantity, summary in zip(quantities, summaries, strict=True):
        comparison = summary.comparison
        footer = _cell(quantity, comparison.baseline, comparison.variant, comparison.gain)
        table.add_column(f"{quantity.label} {quantity.unit}".strip(), footer=footer, justify="right")
    times = [view.milliseconds for view in views if view.milliseconds is not None]
    if times:
        table.add_column("ms", footer=f"{statistics.fmean(times):.0f}", justify="right")
    for index, view in enumerate(views):
        cells: list[str | Text] = [f"{view.name}\nworst" if index == worst else view.name]
        cells += [_view_cell(view, quantity) for quantity in quantities]
        if times:
            cells.append("–" if view.milliseconds is None else f"{view.milliseconds:.0f}")
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in cells))
    return table


def reasons(views: Sequence[ComparedView]) -> str:
    """Reasons for missing metrics, one per line; empty if all were measured."""
    return "\n".join(sorted({f"{key}: {reason}" for view in views for key, reason in view.reasons.items()}))


def _view_cell(view: ComparedView, quantity: Quantity) -> Text:
    gain = gain_of(view, quantity.key)
    if gain is None:
        return Text("–", style="dim")
    return _cell(quantity, view.metrics_raw[quantity.key], view.metrics_enhanced[quantity.key], gain)


def _cell(quantity: Quantity, raw: float, enhanced: float, gain: float) -> Text:
    numbers = f"{quantity.format_value(raw)}→{quantity.format_value(enhanced)}\n"
    return Text(numbers).append(quantity.format_gain(gain), style=STYLES[quantity.verdict(gain)])
