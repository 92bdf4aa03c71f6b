"""The report page: one self-contained HTML file with all images, numbers and scripts.

No external address is ever loaded; a content security policy in the page makes the browser enforce this.
"""

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from typing import Any

from gaussian_enhancer.report.cards import CardImages, card, pictured_indices
from gaussian_enhancer.report.compared import ComparedView, check_names
from gaussian_enhancer.report.quantities import Quantity
from gaussian_enhancer.report.summary import MetricSummary, gain_of, measured_quantities, summarise, worst_view
from gaussian_enhancer.report.templating import render

POLICY = "img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
"""Content security policy: pictures, style and script are embedded in the page."""


def document(
    title: str, views: Sequence[ComparedView], provenance: Mapping[str, str], *, most_pictured: int = 60
) -> str:
    """The HTML of the page that compares renders before and after enhancement.

    Args:
        title: the page's title.
        views: the compared views, in the order in which they are shown.
        provenance: origin of the numbers: commit, configuration, machine, time, weights.
        most_pictured: maximum number of views with pictures. If there are more views, an even selection that includes
            the worst one is pictured, and the page states this. Numbers are shown for all views.

    Raises:
        InputError: there is no view, a name occurs twice, or images of one view differ in size.
    """
    check_names(views)
    summaries = [summarise(views, quantity) for quantity in measured_quantities(views)]
    worst = worst_view(summaries)
    indices = pictured_indices(len(views), worst, most_pictured)
    pictures = CardImages.of([views[i] for i in indices])
    quantities = [summary.quantity for summary in summaries]
    values = {
        "title": title,
        "policy": POLICY,
        "subtitle": _subtitle(views, len(indices)),
        "ramp": pictures.ramp,
        "scale": pictures.scale,
        "portrait": pictures.portrait,
        "views": views,
        "tiles": summaries,
        "times": [view.milliseconds for view in views if view.milliseconds is not None],
        "quantities": quantities,
        "columns": [metric for metric in quantities if any(gain_of(view, metric.key) is not None for view in views)],
        "shown": set(indices),
        "worst": worst,
        "cards": [card(i, views[i], pictures, worst=i == worst) for i in indices],
        "gain_of": gain_of,
        "bar_width": partial(_bar_width, {metric.key: _largest_gain(views, metric.key) for metric in quantities}),
        "unmeasured": partial(_missing_reason, views),
        "provenance": provenance,
        "data": report_data(title, views, summaries, provenance),
        "written": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }
    return render("report.html", values)


def _largest_gain(views: Sequence[ComparedView], key: str) -> float:
    """The largest magnitude of a metric's finite gains; 0 if there are none."""
    gains = [gain for view in views if (gain := gain_of(view, key)) is not None]
    return max((abs(gain) for gain in gains if math.isfinite(gain)), default=0.0)


def _bar_width(largest_gains: Mapping[str, float], gain: float, quantity: Quantity) -> float:
    """Width of a gain's bar in percent of its cell: 50 for the metric's largest finite gain, else in proportion."""
    largest = largest_gains[quantity.key]
    return 50 * min(1.0, abs(gain) / largest) if math.isfinite(gain) and largest > 0 else 0.0


def _missing_reason(views: Sequence[ComparedView], summary: MetricSummary) -> str:
    """The reason why a metric has no mean."""
    if summary.infinite:
        return f"not finite in {summary.infinite} views (identical images)"
    key = summary.quantity.key
    reasons = sorted({view.reasons[key] for view in views if key in view.reasons})
    text = " · ".join(reason.removeprefix("not measured: ") for reason in reasons)
    return text or "not measured on render and enhanced render alike"


def report_data(
    title: str, views: Sequence[ComparedView], summaries: Sequence[MetricSummary], provenance: Mapping[str, str]
) -> dict[str, Any]:
    """All numbers of the page, unrounded, as in the page's JSON block (element ``report-data``)."""
    return {
        "title": title,
        "provenance": dict(provenance),
        "summary": {
            s.quantity.key: {
                "raw": s.comparison.baseline,
                "enhanced": s.comparison.variant,
                "gain": s.comparison.gain,
                "sd": s.comparison.deviation,
                "n": s.comparison.count,
                "left_out": s.comparison.left_out,
                "improved": s.improved,
                "worst": s.comparison.worst,
            }
            for s in summaries
        },
        "views": [
            {
                "name": view.name,
                "raw": dict(view.metrics_raw),
                "enhanced": dict(view.metrics_enhanced),
                "gain": {key: gain for key in view.metrics_raw if (gain := gain_of(view, key)) is not None},
                "milliseconds": view.milliseconds,
                "reasons": dict(view.reasons),
            }
            for view in views
        ],
    }


def _subtitle(views: Sequence[ComparedView], pictured_count: int) -> str:
    photos = sum(view.read_photo is not None for view in views)
    count = f"{len(views)} view{'s' if len(views) != 1 else ''}"
    against = f"measured against {'their' if photos == len(views) else str(photos)} photos" if photos else "no photos"
    selection = "" if pictured_count == len(views) else f" · pictures of {pictured_count}, numbers of all"
    return f"{count} · {against}{selection}"
