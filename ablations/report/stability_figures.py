"""Diagrams of the stability study: the matrix in colour, and the sampler's error by steps. SVG, without a library."""

import math
from collections.abc import Callable, Sequence

from ablations.stability.case import PASSES, PRECISIONS
from ablations.stability.judge import FAILED, REFUSED, WITHIN
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.report.markup import Markup, joined, tag

Number = int | float

RAISED = "computed in float32"
"""Within tolerance, because the code answers in float32 whatever it is given."""

COLOURS = {WITHIN: "#4c9a6a", RAISED: "#8fb8de", REFUSED: "#e0b341", FAILED: "#b3261e"}
"""By outcome; they differ in lightness, so that grey print tells them apart."""

CURVES = ("#1b5e8c", "#c2571a", "#4c9a6a", "#7d4fa3", "#8a6d1f", "#333333")
STYLE = "font: 11px system-ui, sans-serif"
ROW, CELL, LEFT, TOP = 16, 26, 190, 112


def outcome_of(record: Record) -> str:
    """What became of a cell, float32 in place of half precision told apart."""
    return RAISED if record.variant == WITHIN and record.reasons.get("computed") == "float32" else record.variant


def matrix_figure(records: Sequence[Record]) -> Markup:
    """The matrix: a row a case, a column a precision and pass; the pointer on a cell shows its error and reason.

    Args:
        records: of kind "stability".
    """
    cells = {(r.run, r.scene, r.splat, r.view): r for r in records}
    columns = [(precision.name, direction) for precision in PRECISIONS for direction in PASSES]
    parts, y, family = [*_legend(), *_heads(columns)], TOP, ""
    for own, case in dict.fromkeys((record.run, record.scene) for record in records):
        if own != family:
            family, y = own, y + ROW
            parts.append(_text(4, y + 12, family, font_weight="bold"))
            y += ROW
        parts.append(_text(LEFT - 6, y + 12, case, text_anchor="end"))
        for place, (precision, direction) in enumerate(columns):
            record = cells.get((own, case, precision, direction))
            if record is not None:
                parts.append(_cell(LEFT + place * CELL + 6 * (place // 2), y, record))
        y += ROW
    return _picture(LEFT + len(columns) * CELL + 96, y + 10, parts)


def _cell(x: Number, y: Number, record: Record) -> Markup:
    outcome, error = outcome_of(record), record.metrics["error"]
    words = f"{record.scene}, {record.splat}, {record.view}: {outcome}"
    if error is not None:
        words += f"; error {error:.2g}, tolerance {record.metrics['tolerance']:.2g}"
    if record.reasons.get("outcome"):
        words += f"; {record.reasons['outcome']}"
    shape = _shape("rect", tag("title", words), x=x, y=y, width=CELL - 2, height=ROW - 2, fill=COLOURS[outcome], rx=2)
    share = _share(record)
    if share is None:
        return shape
    # The darker part is the error on a logarithmic scale, from a millionth of the tolerance to all of it.
    return joined(
        shape, _shape("rect", x=x, y=y + ROW - 5, width=round(share * (CELL - 2), 1), height=3, fill="#00000066")
    )


def _share(record: Record) -> float | None:
    error, tolerance = record.metrics["error"], record.metrics["tolerance"]
    if not error or not tolerance or not math.isfinite(error) or not math.isfinite(tolerance):
        return None
    return min(1.0, max(0.0, 1 + math.log10(error / tolerance) / 6))


def _heads(columns: Sequence[tuple[str, str]]) -> list[Markup]:
    heads = []
    for place, (precision, direction) in enumerate(columns):
        x = LEFT + place * CELL + 6 * (place // 2) + 14
        turned = f"rotate(-60 {x} {TOP + 8})"
        heads.append(_text(x, TOP + 8, f"{precision}, {direction}", transform=turned, font_size="9"))
    return heads


def _legend() -> list[Markup]:
    parts = []
    for place, (outcome, colour) in enumerate(COLOURS.items()):
        parts.append(_shape("rect", x=8, y=8 + 16 * place, width=12, height=12, fill=colour, rx=2))
        parts.append(_text(26, 18 + 16 * place, outcome))
    return parts


def order_figure(records: Sequence[Record]) -> Markup:
    """Error over steps, both logarithmic, one curve a schedule, and a line that falls as one over the steps.

    Args:
        records: of kind "sampler order".
    """
    curves: dict[str, list[tuple[Number, Number]]] = {}
    for record in records:
        steps, error = record.metrics["steps"], record.metrics["error"]
        if steps and error:
            curves.setdefault(record.scene, []).append((math.log10(steps), math.log10(error)))
    points = [point for curve in curves.values() for point in curve]
    right = max((x for x, _ in points), default=1.0) or 1.0
    low, high = math.floor(min((y for _, y in points), default=-1)), math.ceil(max((y for _, y in points), default=0))

    def place(x: Number, y: Number) -> tuple[Number, Number]:
        return 60 + 440 * x / right, 20 + 300 * (high - y) / max(1, high - low)

    parts = _axes(right, low, high, place)
    start = high - 0.5
    ends = [place(x, start - x) for x in (0.0, min(right, start - low))]
    parts.append(_line(ends, "#999999", stroke_dasharray="4 4"))
    parts.append(_text(516, 36, "dashed: order 1"))
    for number, (name, curve) in enumerate(curves.items()):
        colour = CURVES[number % len(CURVES)]
        drawn = [place(*point) for point in sorted(curve)]
        parts.append(_line(drawn, colour, stroke_width="2"))
        parts += [_shape("circle", cx=round(x, 1), cy=round(y, 1), r=3, fill=colour) for x, y in drawn]
        parts.append(_text(516, 60 + 18 * number, name, fill=colour))
    return _picture(640, 370, parts)


def _axes(right: float, low: int, high: int, place: Callable[[Number, Number], tuple[Number, Number]]) -> list[Markup]:
    parts = []
    for decade in range(math.floor(right) + 1):
        (x, top), (_, bottom) = place(decade, high), place(decade, low)
        parts += [
            _line([(x, top), (x, bottom)], "#dddddd"),
            _text(x, bottom + 16, f"{10**decade:g}", text_anchor="middle"),
        ]
    for decade in range(low, high + 1):
        (left, y), (end, _) = place(0, decade), place(right, decade)
        parts += [
            _line([(left, y), (end, y)], "#dddddd"),
            _text(left - 6, y + 4, f"{10.0**decade:g}", text_anchor="end"),
        ]
    parts.append(_text(280, 358, "steps", text_anchor="middle"))
    parts.append(_text(14, 170, "error", text_anchor="middle", transform="rotate(-90 14 170)"))
    return parts


def _shape(name: str, *children: str, **attributes: Number | str) -> Markup:
    """An element; numbers are written as short as they are."""
    return tag(name, *children, **{key: v if isinstance(v, str) else f"{v:g}" for key, v in attributes.items()})


def _line(points: Sequence[tuple[Number, Number]], colour: str, **attributes: str) -> Markup:
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return _shape("polyline", points=path, fill="none", stroke=colour, **attributes)


def _text(x: Number, y: Number, words: str, **attributes: str) -> Markup:
    return _shape("text", words, x=round(x, 1), y=round(y, 1), **attributes)


def _picture(width: Number, height: Number, parts: Sequence[Markup]) -> Markup:
    ground = _shape("rect", width="100%", height="100%", fill="#ffffff")
    return _shape(
        "svg",
        ground,
        *parts,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {width:g} {height:g}",
        width=width,
        height=height,
        style=STYLE,
    )
