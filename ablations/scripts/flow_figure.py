"""``gaussian-enhancer flow_figure``: the flow of data on the page "How it works".

Boxes have a light ground of their own and lines are middle grey: the picture reads on light and on dark pages.
"""

from dataclasses import dataclass
from xml.sax.saxutils import escape

from omegaconf import DictConfig

from gaussian_enhancer.files import write_text

WIDTH, HEIGHT = 1000, 400
BOX = (150, 62)
"""Width and height of a box."""
GROUNDS = {"data": "#e8f0fe", "step": "#fff4d6", "result": "#e3f4e4"}
LINE, INK = "#80868b", "#202124"


@dataclass(frozen=True)
class Box:
    """A box of the picture.

    Args:
        kind: data, step or result.
        x: left side.
        y: upper side.
        title: first line.
        text: second line, the package or a note.
    """

    kind: str
    x: int
    y: int
    title: str
    text: str


BOXES = {
    "capture": Box("data", 20, 20, "capture", "photos, cameras"),
    "fit": Box("step", 220, 20, "fit", "splat"),
    "splat": Box("data", 420, 20, "splat", "Gaussians"),
    "render": Box("step", 620, 20, "render", "splat"),
    "views": Box("data", 820, 20, "target view", "render, depth, alpha"),
    "choose": Box("step", 20, 170, "choose references", "align"),
    "depth": Box("step", 220, 170, "refine depth", "align"),
    "warp": Box("step", 420, 170, "warp references", "align, exposure"),
    "network": Box("step", 620, 170, "fuse, add residual", "network"),
    "clamp": Box("step", 820, 170, "clamp colours", "infer"),
    "simulate": Box("step", 220, 320, "simulate renders", "degrade, from photos"),
    "train": Box("step", 420, 320, "train", "train, loss"),
    "weights": Box("data", 620, 320, "weights", "lr_tiny, ..."),
    "enhanced": Box("result", 820, 320, "enhanced view", "metrics, report"),
}
ARROWS = (
    "capture fit",
    "fit splat",
    "splat render",
    "render views",
    "capture choose",
    "choose depth",
    "depth warp",
    "warp network",
    "views clamp",
    "splat warp",
    "network clamp",
    "clamp enhanced",
    "simulate train",
    "train weights",
    "weights network",
)
"""Pairs of boxes, from and to."""


def flow() -> str:
    """The picture as SVG."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" role="img">',
        "<title>Data flow: a capture is fitted, rendered, aligned, enhanced and measured</title>",
        f'<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        f'<path d="M0 0L8 4L0 8z" fill="{LINE}"/></marker></defs>',
        *(_arrow(*(BOXES[name] for name in arrow.split())) for arrow in ARROWS),
        *(_box(box) for box in BOXES.values()),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _arrow(start: Box, end: Box) -> str:
    width, height = BOX
    if start.y == end.y:
        points = (start.x + width, start.y + height // 2, end.x - 3, end.y + height // 2)
    else:
        down = end.y > start.y
        side = width // 2
        points = (start.x + side, start.y + height * down, end.x + side, end.y + (-3 if down else height + 3))
    x1, y1, x2, y2 = points
    return f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" stroke="{LINE}" stroke-width="2" marker-end="url(#tip)"/>'


def _box(box: Box) -> str:
    width, height = BOX
    middle = box.x + width // 2
    return (
        f'<rect x="{box.x}" y="{box.y}" width="{width}" height="{height}" rx="8" fill="{GROUNDS[box.kind]}" '
        f'stroke="{LINE}"/>'
        f'<text x="{middle}" y="{box.y + 27}" text-anchor="middle" font-size="14" font-weight="bold" fill="{INK}">'
        f"{escape(box.title)}</text>"
        f'<text x="{middle}" y="{box.y + 47}" text-anchor="middle" font-size="12" fill="{INK}">'
        f"{escape(box.text)}</text>"
    )


def run(cfg: DictConfig) -> None:
    """Write the picture.

    Args:
        cfg: conf/flow_figure.yaml, composed.

    Raises:
        InputError: it cannot be written.
    """
    write_text(cfg.output, flow())
