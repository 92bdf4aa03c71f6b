"""Plots of studies by matplotlib, as deterministic SVG text."""

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ablations.study.pareto import pareto_front
from gaussian_enhancer.metrics.tradeoff import Point

MARKERS = "os^DXP"
STYLE = {
    "font.size": 9,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.alpha": 0.4,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "text.parse_math": False,
    "svg.hashsalt": "gaussian-enhancer",
}


@dataclass(frozen=True)
class Mark:
    """One setting of a method.

    Args:
        label: the setting's name.
        x: time, above 0.
        y: error, above 0.
        low: lower end of the time's error bar.
        high: its upper end.
    """

    label: str
    x: float
    y: float
    low: float | None = None
    high: float | None = None

    @property
    def drawable(self) -> bool:
        """Whether the mark can be drawn on logarithmic axes."""
        return all(math.isfinite(value) and value > 0 for value in (self.x, self.y))


@dataclass(frozen=True)
class Panel:
    """One diagram of error over time.

    Args:
        title: title of the diagram.
        x_title: label of the time axis, with its unit.
        y_title: label of the error axis, with its unit.
        curves: marks by method, in the order in which they are joined.
        baseline: name and error of a method of negligible time, drawn as a horizontal line.
    """

    title: str
    x_title: str
    y_title: str
    curves: Mapping[str, Sequence[Mark]] = field(default_factory=dict)
    baseline: tuple[str, float] | None = None


def work_precision(title: str, panels: Sequence[Panel], columns: int) -> str:
    """Plot error over run time on logarithmic axes: a grid of panels with one legend, Pareto fronts as staircases.

    Args:
        title: title of the figure.
        panels: row by row.
        columns: panels per row.
    """
    plt = _pyplot()
    names = list(dict.fromkeys(name for panel in panels for name in panel.curves))
    columns = max(1, min(columns, len(panels)))
    rows = max(1, -(-len(panels) // columns))
    legend = -(-len(names) // (2 * columns))
    with plt.rc_context(STYLE):
        size = (5 * columns, 4 * rows + 0.2 * legend + 0.4)
        figure, axes = plt.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained")
        figure.suptitle(title, fontweight="bold")
        for axis in axes.flat[len(panels) :]:
            axis.set_axis_off()
        lines: dict[str, Any] = {}
        for axis, panel in zip(axes.flat, panels, strict=False):
            _panel(axis, panel, names, lines)
        if lines:
            figure.legend(lines.values(), lines.keys(), loc="outside lower center", ncols=2 * columns)
        return _svg(figure, title)


def _panel(axis: Any, panel: Panel, names: Sequence[str], lines: dict[str, Any]) -> None:
    """Draw one panel; one line of each method is added to ``lines`` for the legend."""
    axis.set(title=panel.title, xlabel=panel.x_title, ylabel=panel.y_title)
    curves = {name: tuple(mark for mark in marks if mark.drawable) for name, marks in panel.curves.items()}
    if not any(curves.values()):
        axis.text(0.5, 0.5, "nothing was measured", ha="center", transform=axis.transAxes)
        return
    axis.set(xscale="log", yscale="log")
    for name, marks in curves.items():
        number = names.index(name)
        x, y = [mark.x for mark in marks], [mark.y for mark in marks]
        spread = [[mark.x - (mark.low or mark.x) for mark in marks], [(mark.high or mark.x) - mark.x for mark in marks]]
        marker = MARKERS[number % len(MARKERS)]
        style = {"color": f"C{number % 10}", "marker": marker, "markersize": 5, "linewidth": 1.4, "label": name}
        lines.setdefault(name, axis.errorbar(x, y, xerr=spread, **style))
    baseline_error = panel.baseline[1] if panel.baseline and panel.baseline[1] > 0 else None
    if panel.baseline and baseline_error:
        axis.axhline(baseline_error, color="grey", linestyle="--", linewidth=1.2)
        axis.annotate(
            panel.baseline[0], (0.01, baseline_error), xycoords=axis.get_yaxis_transform(), va="bottom", fontsize=8
        )
    front_points = front_of_curves(curves, baseline_error)
    if front_points:
        x, y = [point.cost for point in front_points], [point.error for point in front_points]
        axis.step([*x, axis.get_xlim()[1]], [*y, y[-1]], where="post", color="black", alpha=0.18, linewidth=5, zorder=0)
        axis.plot(x, y, linestyle="", marker="o", markersize=11, markerfacecolor="none", color="black")
        _name_points(axis, front_points)
    _round_ticks(axis)


def _name_points(axis: Any, points: Sequence[Point]) -> None:
    """Write names beside points, except points close to one that is already named."""
    named: list[tuple[float, float]] = []
    for point in points:
        x, y = axis.transAxes.inverted().transform(axis.transData.transform((point.cost, point.error)))
        if all(math.hypot(x - other_x, y - other_y) > 0.12 for other_x, other_y in named):
            left = x > 0.6
            style = {"textcoords": "offset points", "fontsize": 7, "ha": "right" if left else "left"}
            axis.annotate(point.name, (point.cost, point.error), (-8 if left else 8, 6), **style)
            named.append((x, y))


def _round_ticks(axes: Any) -> None:
    """Set ticks at 1, 2 and 5 times powers of ten, or at round steps where an axis spans less than a decade.

    Over more than about 2.5 decades (a ratio of 300), ticks are at powers of ten alone.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        subs = (1, 2, 5) if high < 300 * low else (1,)
        axis.set_major_locator(MaxNLocator(5) if high < 10 * low else LogLocator(subs=subs, numticks=9))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def front_of_curves(curves: Mapping[str, Sequence[Mark]], baseline_error: float | None) -> tuple[Point, ...]:
    """The Pareto front of all curves, without points no better than the baseline, which takes no time."""
    points = [Point(f"{name}, {mark.label}", mark.x, mark.y) for name, marks in curves.items() for mark in marks]
    return tuple(point for point in pareto_front(points) if baseline_error is None or point.error < baseline_error)


def bar_panels(title: str, panels: Sequence[tuple[str, Mapping[str, float], Sequence[float], str]]) -> str:
    """Plot panels of horizontal bars, side by side.

    Args:
        title: title of the figure.
        panels: title, values by name, positions of dashed lines, and format of the values.
    """
    plt = _pyplot()
    with plt.rc_context(STYLE):
        height = 1.4 + 0.32 * max((len(values) for _, values, _, _ in panels), default=1)
        figure, axes = plt.subplots(
            1, len(panels), figsize=(5 * len(panels), height), squeeze=False, layout="constrained"
        )
        figure.suptitle(title, fontweight="bold")
        for axis, (name, values, lines, form) in zip(axes.flat, panels, strict=True):
            bars = axis.barh(list(values), list(values.values()), color="C0")
            axis.bar_label(bars, fmt=form, padding=3)
            axis.margins(x=0.2)
            axis.invert_yaxis()
            axis.set_title(name)
            for line in lines:
                axis.axvline(line, color="black", linestyle="--", linewidth=1)
        return _svg(figure, title)


def category_matrix(
    title: str,
    cells: Mapping[tuple[str, str], str],
    rows: Sequence[str],
    columns: Sequence[str],
    colours: Mapping[str, str],
) -> str:
    """Plot a matrix of categories in colour.

    Args:
        title: title of the figure.
        cells: category by row and column; a cell without one is white.
        rows: from top to bottom.
        columns: from left to right.
        colours: by category, in the legend's order.
    """
    plt = _pyplot()
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    names = list(colours)
    numbers = [[names.index(cells[row, c]) if (row, c) in cells else math.nan for c in columns] for row in rows]
    with plt.rc_context({**STYLE, "axes.grid": False, "font.size": 7}):
        figure, axis = plt.subplots(figsize=(2.5 + 0.35 * len(columns), 2 + 0.15 * len(rows)), layout="constrained")
        style = {"cmap": ListedColormap(list(colours.values())), "vmin": -0.5, "vmax": len(names) - 0.5}
        axis.pcolormesh(numbers, edgecolors="white", linewidth=1, **style)
        axis.set_xticks([i + 0.5 for i in range(len(columns))], columns, rotation=60, ha="left")
        axis.set_yticks([i + 0.5 for i in range(len(rows))], rows)
        axis.invert_yaxis()
        axis.xaxis.tick_top()
        patches = [Patch(color=colour, label=name) for name, colour in colours.items()]
        figure.legend(handles=patches, loc="outside lower center", ncols=2)
        figure.suptitle(title, fontweight="bold")
        return _svg(figure, title)


def convergence(title: str, curves: Mapping[str, Sequence[tuple[float, float]]], x_title: str, y_title: str) -> str:
    """Plot error over steps on logarithmic axes: one curve per method, and a dashed line of order 1."""
    plt = _pyplot()
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
        axis.set(title=title, xlabel=x_title, ylabel=y_title, xscale="log", yscale="log")
        for number, (name, points) in enumerate(curves.items()):
            x, y = zip(*sorted(points), strict=True)
            axis.plot(x, y, marker=MARKERS[number % len(MARKERS)], markersize=4, label=name)
        steps = sorted({x for points in curves.values() for x, _ in points})
        if steps:
            top = max(y for points in curves.values() for _, y in points)
            axis.plot(steps, [top * steps[0] / x for x in steps], "--", color="grey", label="order 1")
        _round_ticks(axis)
        figure.legend(loc="outside right upper")
        return _svg(figure, title)


def _pyplot() -> Any:
    """Pyplot with a backend that needs no display."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot

    return matplotlib.pyplot


def _svg(figure: Any, title: str) -> str:
    """The figure as SVG text without date; closes the figure."""
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Title": title})
    _pyplot().close(figure)
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines()) + "\n"
