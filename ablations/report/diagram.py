"""Work-precision diagrams: error over run time on logarithmic axes, as SVG that is legible on light and on dark.

One curve a method through its settings, the spread of each time as a bar, the Pareto front as a staircase. Written by
hand: no plotting library is needed to read or to make them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from ablations.report.axes import Axis, axis, ticks, told
from gaussian_enhancer.metrics.tradeoff import Point, front
from gaussian_enhancer.report.markup import Markup, joined, tag

COLOURS = (
    "#3f83f8", "#e4572e", "#1f9d6b", "#a259ec", "#c58a00", "#dd4f93", "#0e9fb3", "#8a7a63",
    "#6f7fff", "#6d9c22", "#c74b50", "#4f8f8f",
)  # fmt: skip
"""Of curves, of even lightness in between those of white and black paper."""

SHAPES = ("circle", "square", "triangle", "diamond", "cross", "plus")
WIDTH, HEIGHT = 400.0, 300.0
"""Of a panel's axes, in pixels of the SVG."""

LEFT, TOP, RIGHT, BOTTOM, LINE = 74.0, 40.0, 18.0, 56.0, 20.0
STYLE = """
svg { --ground: #ffffff; --ink: #1f2328; --quiet: #59636e; --line: #d1d9e0; font: 12px system-ui, sans-serif; }
@media (prefers-color-scheme: dark) { svg { --ground: #0d1117; --ink: #f0f6fc; --quiet: #9198a1; --line: #3d444d; } }
text { fill: var(--ink); } .quiet { fill: var(--quiet); } .title { font-weight: 600; font-size: 13px; }
.head { font-weight: 600; font-size: 15px; } .small { font-size: 10.5px; }
.halo { paint-order: stroke; stroke: var(--ground); stroke-width: 3px; stroke-linejoin: round; }
.grid { stroke: var(--line); stroke-width: 0.7; } .frame { fill: none; stroke: var(--line); }
.front { fill: none; stroke: var(--ink); stroke-width: 5; stroke-opacity: 0.16; stroke-linejoin: round; }
.ring { fill: none; stroke: var(--ink); stroke-width: 1.3; }
.leader { stroke: var(--quiet); stroke-width: 0.7; }
.base { stroke: var(--quiet); stroke-width: 1.2; stroke-dasharray: 5 4; }
"""


@dataclass(frozen=True)
class Mark:
    """One setting.

    Args:
        label: the setting's name.
        x: time, above 0.
        y: error, above 0.
        low: lower end of the time's spread.
        high: its upper end.
    """

    label: str
    x: float
    y: float
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Panel:
    """One diagram.

    Args:
        title: above it.
        x_title: of the time's axis, with its unit.
        y_title: of the error's axis, with its unit.
        curves: marks by method, each in the order in which they are joined.
        baseline: name and error of what takes no time worth a place on the axis.
        joined_up: whether a curve's marks are joined by a line.
        fronted: whether the Pareto front is marked.
    """

    title: str
    x_title: str
    y_title: str
    curves: dict[str, tuple[Mark, ...]] = field(default_factory=dict)
    baseline: tuple[str, float] | None = None
    joined_up: bool = True
    fronted: bool = True


def drawn(name: str, *children: str, **attributes: str | float | int) -> Markup:
    """An element; numbers among its attributes as short as they may be.

    Args:
        name: the element's.
        *children: text (escaped) or markup (kept).
        **attributes: as those of `tag`.
    """
    words = {key: value if isinstance(value, str) else f"{value:.7g}" for key, value in attributes.items()}
    return tag(name, *children, **words)


def drawable(mark: Mark) -> bool:
    """Whether a mark has a place on logarithmic axes."""
    return all(math.isfinite(value) and value > 0 for value in (mark.x, mark.y))


def diagram(title: str, panels: Sequence[Panel], columns: int) -> str:
    """A grid of panels over one legend.

    Args:
        title: over all.
        panels: row by row.
        columns: panels in a row.

    Returns:
        The SVG document.
    """
    names = list(dict.fromkeys(name for panel in panels for name in panel.curves))
    columns = max(1, min(columns, len(panels)))
    across, down = LEFT + WIDTH + RIGHT, TOP + HEIGHT + BOTTOM
    rows = -(-len(panels) // columns)
    per_line = max(1, int(columns * across // 220))
    width, height = columns * across, 34 + rows * down + LINE * -(-len(names) // per_line) + 14
    parts = [drawn("text", title, x=LEFT, y=24, class_="head")]
    for index, panel in enumerate(panels):
        left, top = index % columns * across + LEFT, 34 + index // columns * down + TOP
        parts.append(drawn("g", *_panel(panel, names), transform=f"translate({left:g} {top:g})"))
    for index, name in enumerate(names):
        x, y = LEFT + index % per_line * 220, 34 + rows * down + LINE * (index // per_line) + 8
        line = drawn("line", x1=x, x2=x + 22, y1=y, y2=y, stroke=_colour(names, name), stroke_width=1.6)
        parts += [line, _shape(names, name, x + 11, y), drawn("text", name, x=x + 30, y=y + 4)]
    ground = drawn("rect", width=width, height=height, fill="var(--ground)")
    box = {"viewBox": f"0 0 {width:g} {height:g}", "width": f"{width:g}", "height": f"{height:g}", "role": "img"}
    head = " ".join(f'{key}="{value}"' for key, value in box.items())
    body = joined(drawn("title", title), drawn("style", Markup(STYLE)), ground, *parts)
    return f'<svg xmlns="http://www.w3.org/2000/svg" {head}>{body}</svg>\n'


def _panel(panel: Panel, names: Sequence[str]) -> list[Markup]:
    curves = {name: tuple(filter(drawable, status)) for name, status in panel.curves.items()}
    status = [mark for own in curves.values() for mark in own]
    parts = [drawn("text", panel.title, x=0, y=-12, class_="title")]
    if not status:
        return [
            *parts,
            drawn("text", "nothing was measured", x=WIDTH / 2, y=HEIGHT / 2, text_anchor="middle", class_="quiet"),
        ]
    spreads = [end for mark in status for end in (mark.low, mark.high) if end]
    across = axis([*(mark.x for mark in status), *spreads], WIDTH)
    base = [panel.baseline[1]] if panel.baseline and panel.baseline[1] > 0 else []
    down = axis([*(mark.y for mark in status), *base], HEIGHT)
    parts += _axes(panel, across, down)
    placed: list[tuple[float, float, float, float]] = []
    if panel.baseline and base:
        y = HEIGHT - down(base[0])
        parts.append(drawn("line", drawn("title", panel.baseline[0]), x1=0, x2=WIDTH, y1=y, y2=y, class_="base"))
        parts.append(drawn("text", panel.baseline[0], x=4, y=y - 5, class_="small quiet halo"))
        placed.append((4.0, y - 16, 4.0 + 6 * len(panel.baseline[0]), y))
    best = _front(curves, base)
    if panel.fronted and best:
        parts.append(drawn("path", d=_stairs(best, base, across, down), class_="front"))
    for name, own in curves.items():
        parts.append(drawn("g", *_curve(panel, name, own, names, across, down)))
    centres = [(across(mark.x), HEIGHT - down(mark.y)) for mark in status]
    placed += [(x - 4, y - 4, x + 4, y + 4) for x, y in centres]
    for point in best if panel.fronted else ():
        x, y = across(point.cost), HEIGHT - down(point.error)
        parts.append(drawn("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r=7, class_="ring"))
        parts += _label(point.name, x, y, placed)
    return parts


def _axes(panel: Panel, across: Axis, down: Axis) -> list[Markup]:
    parts = [drawn("rect", width=WIDTH, height=HEIGHT, class_="frame")]
    for value in ticks(across.low, across.high):
        x = f"{across(value):.1f}"
        parts.append(drawn("line", x1=x, x2=x, y1=0, y2=HEIGHT, class_="grid"))
        parts.append(drawn("text", told(value), x=x, y=HEIGHT + 17, text_anchor="middle", class_="quiet"))
    for value in ticks(down.low, down.high):
        y = HEIGHT - down(value)
        parts.append(drawn("line", x1=0, x2=WIDTH, y1=f"{y:.1f}", y2=f"{y:.1f}", class_="grid"))
        parts.append(drawn("text", told(value), x=-7, y=f"{y + 4:.1f}", text_anchor="end", class_="quiet"))
    parts.append(drawn("text", panel.x_title, x=WIDTH / 2, y=HEIGHT + 38, text_anchor="middle"))
    turned = f"translate(-58 {HEIGHT / 2:g}) rotate(-90)"
    return [*parts, drawn("text", panel.y_title, text_anchor="middle", transform=turned)]


def _curve(
    panel: Panel, name: str, status: Sequence[Mark], names: Sequence[str], across: Axis, down: Axis
) -> list[Markup]:
    colour, parts = _colour(names, name), []
    places = [(across(mark.x), HEIGHT - down(mark.y)) for mark in status]
    if panel.joined_up and len(status) > 1:
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        parts.append(drawn("polyline", points=line, fill="none", stroke=colour, stroke_width=1.6))
    for mark, (x, y) in zip(status, places, strict=True):
        if mark.low and mark.high:
            ends = {"x1": f"{across(mark.low):.1f}", "x2": f"{across(mark.high):.1f}"}
            parts.append(drawn("line", y1=f"{y:.1f}", y2=f"{y:.1f}", stroke=colour, stroke_width=1.2, **ends))
        words = f"{name}, {mark.label}: {mark.x:.4g}, {mark.y:.4g}"
        parts.append(drawn("g", drawn("title", words), _shape(names, name, x, y)))
    return parts


def _front(curves: dict[str, tuple[Mark, ...]], base: Sequence[float]) -> tuple[Point, ...]:
    """The Pareto front of all curves; what is no better than the baseline, which takes no time, is not on it."""
    points = [Point(f"{name}, {mark.label}", mark.x, mark.y) for name, status in curves.items() for mark in status]
    return tuple(point for point in front(points) if not base or point.error < base[0])


def _stairs(best: Sequence[Point], base: Sequence[float], across: Axis, down: Axis) -> str:
    """From the left edge (or the top) along the least error that each time buys, to the right edge."""
    places = [(across(point.cost), HEIGHT - down(point.error)) for point in best]
    x, y = places[0]
    path = f"M0 {HEIGHT - down(base[0]):.1f} H{x:.1f} V{y:.1f}" if base else f"M{x:.1f} 0 V{y:.1f}"
    for x, y in places[1:]:
        path += f" H{x:.1f} V{y:.1f}"
    return f"{path} H{WIDTH:g}"


def _label(words: str, x: float, y: float, placed: list[tuple[float, float, float, float]]) -> list[Markup]:
    """The words beside a mark where nothing else stands; none where there is no room (a mark tells its name itself)."""
    wide = 5.6 * len(words)
    for dy in (-8.0, 14.0, -22.0, 28.0):
        for dx in (10.0, -10.0 - wide):
            box = (x + dx, y + dy - 10, x + dx + wide, y + dy + 2)
            inside = box[0] >= 0 and box[2] <= WIDTH + RIGHT and box[1] >= 0 and box[3] <= HEIGHT
            if not inside or any(_overlap(box, other) for other in placed):
                continue
            placed.append(box)
            text = drawn("text", words, x=f"{x + dx:.1f}", y=f"{y + dy:.1f}", class_="small halo")
            if dy in (-8.0, 14.0):
                return [text]
            near = x + 9 if dx > 0 else x - 9
            ends = {"x1": f"{x:.1f}", "y1": f"{y:.1f}", "x2": f"{near:.1f}", "y2": f"{y + dy - 4:.1f}"}
            return [drawn("line", class_="leader", **ends), text]
    return []


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _colour(names: Sequence[str], name: str) -> str:
    return COLOURS[names.index(name) % len(COLOURS)]


def _shape(names: Sequence[str], name: str, x: float, y: float) -> Markup:
    """The mark of a curve: colours come round every twelve curves and shapes every six, but not together."""
    index = names.index(name)
    shape = SHAPES[(index + index // len(COLOURS)) % len(SHAPES)]
    at = f"translate({x:.1f} {y:.1f})"
    if shape in ("cross", "plus"):
        turn = " rotate(45)" if shape == "cross" else ""
        return drawn("path", d="M-5 0H5M0 -5V5", stroke=_colour(names, name), stroke_width=2.4, transform=at + turn)
    outline = {
        "circle": "M-4 0A4 4 0 1 0 4 0A4 4 0 1 0 -4 0Z",
        "square": "M-3.7 -3.7H3.7V3.7H-3.7Z",
        "triangle": "M0 -5L4.8 3.6H-4.8Z",
        "diamond": "M0 -5.2L5.2 0L0 5.2L-5.2 0Z",
    }[shape]
    return drawn("path", d=outline, fill=_colour(names, name), transform=at)
