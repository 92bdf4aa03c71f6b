"""Overview of a report: a tile per metric and a sortable table of all views."""

import math
import statistics
from collections.abc import Sequence

from gaussian_enhancer.report.compared import ComparedView
from gaussian_enhancer.report.markup import Markup, joined, tag
from gaussian_enhancer.report.quantities import Quantity
from gaussian_enhancer.report.summary import Summary, gain_of


def summary_tiles(views: Sequence[ComparedView], summaries: Sequence[Summary]) -> Markup:
    """One tile a metric with mean gain, spread and worst view, and one for the time."""
    tiles = [_metric_tile(views, summary) for summary in summaries]
    if not summaries:
        tiles.append(_tile("Quality", tag("p", "not measured", class_="big"), "No photos to measure against."))
    times = [view.milliseconds for view in views if view.milliseconds is not None]
    if times:
        big = tag("p", f"{statistics.fmean(times):.0f}", tag("small", " ms"), class_="big")
        tiles.append(_tile("Time a view", big, f"{min(times):.0f}–{max(times):.0f} ms · n {len(times)}"))
    return joined(*tiles)


def _metric_tile(views: Sequence[ComparedView], summary: Summary) -> Markup:
    quantity, found = summary.quantity, summary.comparison
    if found.count == 0:
        reasons = sorted({view.reasons[quantity.key] for view in views if quantity.key in view.reasons})
        text = (
            " · ".join(reason.removeprefix("not measured: ") for reason in reasons)
            or "not measured on render and enhanced render alike"
        )
        if summary.infinite:
            text = f"not finite in {summary.infinite} views (identical images)"
        return _tile(
            quantity.label,
            tag("p", "not measured", class_="big quiet"),
            text,
            key=quantity.key,
            meaning=quantity.meaning,
        )
    unit = tag("small", f" {quantity.unit}") if quantity.unit else ""
    number = tag("span", quantity.gain_written(found.gain), data_of="gain", data_value=repr(found.gain))
    big = tag("p", number, unit, class_=f"big {quantity.verdict(found.gain)}")
    spread = "" if math.isnan(found.deviation) else f"sd {quantity.written(found.deviation)} · "
    better = "" if quantity.higher_is_better is None else f" · {summary.improved} better"
    beyond = f" · {summary.infinite} not finite, left out" if summary.infinite else ""
    lines = [
        tag("p", f"{quantity.written(found.baseline)} → {quantity.written(found.variant)}"),
        tag("p", f"{spread}n {found.count}{better}{beyond}", class_="quiet"),
    ]
    if summary.worst is not None and found.count > 1:
        worst = gain_of(views[summary.worst], quantity.key) or 0.0
        link = tag("a", views[summary.worst].name, href=f"#view-{summary.worst}")
        gain = tag("span", quantity.gain_written(worst), class_=quantity.verdict(worst))
        lines.append(tag("p", "worst", gain, link, class_="quiet worst"))
    return _tile(quantity.label, big, *lines, key=quantity.key, meaning=quantity.meaning)


def _tile(label: str, big: Markup, *lines: str, key: str | None = None, meaning: str = "") -> Markup:
    content = [line if isinstance(line, Markup) else tag("p", line, class_="quiet") for line in lines]
    return tag("section", tag("h3", label, title=meaning or None), big, *content, class_="tile", data_metric=key)


def overview_table(
    views: Sequence[ComparedView], quantities: Sequence[Quantity], worst: int | None, shown: set[int]
) -> Markup:
    """Gain of every view in every metric that was measured.

    Args:
        views: all views.
        quantities: the metrics of the report, in order; those that no view has get no column.
        worst: index of the view that fared worst.
        shown: indices of views that have a card to link to.
    """
    columns = [quantity for quantity in quantities if any(gain_of(v, quantity.key) is not None for v in views)]
    if not columns:
        return Markup()
    reach = {column.key: _reach(views, column) for column in columns}
    heads = [_head("View", "name")]
    heads += [_head(f"Δ {column.label}", column.key, column.meaning) for column in columns]
    timed = any(view.milliseconds is not None for view in views)
    if timed:
        heads.append(_head("ms", "milliseconds"))
    rows = []
    for index, view in enumerate(views):
        name = tag("a", view.name, href=f"#view-{index}") if index in shown else tag("span", view.name)
        badge = tag("span", "worst", class_="badge") if index == worst else ""
        cells = [tag("th", tag("span", name, badge, class_="name"), scope="row", data_value=view.name)]
        cells += [_gain_cell(view, column, reach[column.key]) for column in columns]
        if timed:
            cells.append(_time_cell(view.milliseconds))
        rows.append(tag("tr", *cells, data_view=str(index)))
    return tag("table", tag("thead", tag("tr", *heads)), tag("tbody", *rows), class_="overview")


def _head(label: str, key: str, meaning: str = "") -> Markup:
    button = tag("button", label, type="button", data_sort=key, title=meaning or None)
    return tag("th", button, scope="col", aria_sort="none")


def _gain_cell(view: ComparedView, quantity: Quantity, reach: float) -> Markup:
    gain = gain_of(view, quantity.key)
    if gain is None:
        return tag("td", "–", title=view.reasons.get(quantity.key, "not measured"), data_metric=quantity.key)
    verdict = quantity.verdict(gain)
    share = 50 * min(1.0, abs(gain) / reach) if math.isfinite(gain) and reach > 0 else 0.0
    side = "right" if verdict == "better" else "left"
    return tag(
        "td",
        tag("i", tag("b", class_=side, style=f"width:{share:.1f}%"), class_="bar"),
        tag("span", quantity.gain_written(gain)),
        class_=verdict,
        data_metric=quantity.key,
        data_value=repr(gain),
    )


def _reach(views: Sequence[ComparedView], quantity: Quantity) -> float:
    gains = [gain_of(view, quantity.key) for view in views]
    return max((abs(gain) for gain in gains if gain is not None and math.isfinite(gain)), default=0.0)


def _time_cell(milliseconds: float | None) -> Markup:
    if milliseconds is None:
        return tag("td", "–")
    return tag("td", f"{milliseconds:.0f}", data_value=repr(milliseconds))
