"""The report page: one self-contained HTML file with all images, numbers and scripts.

No address outside the page is ever loaded; a content security policy in the page makes the browser enforce it.
"""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gaussian_enhancer.files import write_text
from gaussian_enhancer.report.cards import Pictures, card, pictured
from gaussian_enhancer.report.compared import ComparedView, check_names
from gaussian_enhancer.report.markup import Markup, fill, head, joined, json_block, resource, tag
from gaussian_enhancer.report.overview import overview_table, summary_tiles
from gaussian_enhancer.report.summary import Summary, gain_of, measured, summarise, worst_view

POLICY = "img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
"""Pictures, style and script are inside the page."""


def write_report(
    path: str | Path,
    title: str,
    views: Sequence[ComparedView],
    provenance: Mapping[str, str],
    *,
    most_pictured: int = 60,
) -> None:
    """Write the page that compares renders before and after enhancing.

    Args:
        path: the HTML file; written whole or not at all.
        title: the page's title.
        views: the compared views, in the order in which they are shown.
        provenance: what made the numbers: commit, configuration, machine, time, weights.
        most_pictured: views that get pictures; beyond it an even choice with the worst among them, and the page
            says so. Numbers are always shown of all views.

    Raises:
        InputError: no views, a name twice, images of one view that differ in size, or the file cannot be written.
    """
    text = document(title, views, provenance, most_pictured=most_pictured)
    write_text(path, text)


def document(
    title: str, views: Sequence[ComparedView], provenance: Mapping[str, str], *, most_pictured: int = 60
) -> Markup:
    """The page's HTML; arguments as for `write_report`."""
    check_names(views)
    summaries = [summarise(views, quantity) for quantity in measured(views)]
    worst = worst_view(summaries)
    shown = pictured(len(views), worst, most_pictured)
    pictures = Pictures.of([views[i] for i in shown])
    quantities = [summary.quantity for summary in summaries]
    ramp = f":root {{ --ramp: linear-gradient(90deg, {pictures.ramp}); }}"
    values = {
        "head": head(title, f"{resource('report.css')}\n{ramp}", POLICY),
        "title": title,
        "subtitle": _subtitle(views, len(shown)),
        "script": Markup(resource("stage.js") + resource("report.js")),
        "summary": summary_tiles(views, summaries),
        "overview": overview_table(views, quantities, worst, set(shown)),
        "modes": Markup("" if pictures.scale is None else resource("modes.html")),
        "least": "320px" if pictures.portrait else "400px",
        "cards": joined(*(card(i, views[i], quantities, pictures, worst=i == worst) for i in shown)),
        "provenance": joined(*(tag("div", tag("dt", k), tag("dd", v)) for k, v in provenance.items())),
        "data": json_block(report_data(title, views, summaries, provenance)),
        "written": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }
    return fill("report.html", values)


def report_data(
    title: str, views: Sequence[ComparedView], summaries: Sequence[Summary], provenance: Mapping[str, str]
) -> dict[str, Any]:
    """Every number of the page, unrounded, as it stands in the page's JSON block (element ``report-data``)."""
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


def _subtitle(views: Sequence[ComparedView], shown: int) -> str:
    photos = sum(view.read_photo is not None for view in views)
    count = f"{len(views)} view{'s' if len(views) != 1 else ''}"
    against = f"measured against {'their' if photos == len(views) else str(photos)} photos" if photos else "no photos"
    left = "" if shown == len(views) else f" · pictures of {shown}, numbers of all"
    return f"{count} · {against}{left}"
