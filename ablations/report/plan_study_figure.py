"""What a plan saves and costs, as bars: an SVG picture without a library."""

from ablations.report.plan_study import Section
from gaussian_enhancer.report.markup import Markup, joined, tag

BAR, LEFT, WIDTH, GAP, TOP = 18, 110, 300, 130, 64
STYLE = """
svg { --ground: #ffffff; --ink: #1f2328; --quiet: #59636e; --bar: #3f83f8; font: 12px system-ui, sans-serif; }
@media (prefers-color-scheme: dark) { svg { --ground: #0d1117; --ink: #f0f6fc; --quiet: #9198a1; } }
text { fill: var(--ink); } .quiet { fill: var(--quiet); } .title { font-weight: 600; }
.bar { fill: var(--bar); } .aim { stroke: var(--ink); stroke-dasharray: 4 4; } .axis { stroke: var(--quiet); }
"""


def diagram(section: Section) -> str:
    """Bars by scene, as SVG: how many times faster the shown plan is, and what it costs in dB.

    Args:
        section: the scenes; a diagram without bars where none was measured.
    """
    cells, aims = section.cells(), section.aims
    ratios = {cell.scene: cell.ratio or 0.0 for cell in cells}
    costs = {cell.scene: cell.costs["psnr"] for cell in cells}
    height = TOP + (BAR + 8) * max(1, len(cells)) + 24
    width = 2 * (LEFT + WIDTH) + GAP - LEFT
    panels = (
        _bars(f"time of {aims.baseline} / time of {aims.shown}", ratios, (1.0, aims.faster), LEFT, height, "{:.2f}x"),
        _bars("PSNR lost, dB", costs, (0.0, aims.allowed), LEFT + WIDTH + GAP, height, "{:+.3f}"),
    )
    title = tag("text", f"What the plan {aims.shown} saves and costs", x=f"{LEFT}", y="22", class_="title")
    ground = tag("rect", width=f"{width}", height=f"{height}", fill="var(--ground)")
    body = joined(tag("style", Markup(STYLE)), ground, title, *panels)
    size = f'width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" role="img" {size}>{body}</svg>\n'


def _bars(title: str, values: dict[str, float], lines: tuple[float, ...], left: int, height: int, form: str) -> Markup:
    """Horizontal bars from the first line on, with dashed lines at what matters."""
    low, high = min(0.0, *values.values(), *lines), max(*values.values(), *lines, 1e-9) if values else max(lines)
    scale = 0.85 * WIDTH / (high - low)
    parts = [tag("text", title, x=f"{left}", y=f"{TOP - 18}", class_="quiet")]
    for number, (name, value) in enumerate(values.items()):
        y, start, end = TOP + number * (BAR + 8), left - low * scale, left + (value - low) * scale
        box = tag(
            "rect",
            x=f"{min(start, end):.1f}",
            width=f"{max(1.0, abs(end - start)):.1f}",
            y=f"{y}",
            height=f"{BAR}",
            class_="bar",
        )
        parts += [
            tag("text", name, x=f"{left - 8}", y=f"{y + 13}", text_anchor="end"),
            box,
            tag("text", form.format(value), x=f"{max(start, end) + 6:.1f}", y=f"{y + 13}", class_="quiet"),
        ]
    for line in lines:
        x = f"{left + (line - low) * scale:.1f}"
        parts.append(tag("line", x1=x, x2=x, y1=f"{TOP - 8}", y2=f"{height - 24}", class_="aim"))
        parts.append(tag("text", f"{line:g}", x=x, y=f"{height - 8}", text_anchor="middle", class_="quiet"))
    return tag("g", *parts)
