"""Pictures of the simulator's output: contact sheets, and one page with all of them.

Axes: h height, w width, _ sizes that may differ from image to image.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from gaussian_enhancer.files import write_text
from gaussian_enhancer.report.figures import contact_sheet, data_uri
from gaussian_enhancer.report.templating import render

EDGE = 320
"""Longest edge in pixels of an image on a sheet."""

PAGE_BYTES = 10_000_000
"""Maximum number of bytes of all pictures of a page together, before base64."""

BACKGROUND = 250 / 255
"""Grey level of a sheet's background."""

MIN_WIDTH, MIN_HEIGHT = 96, 24
"""Smallest size in pixels of an image on a sheet, so that its text fits."""


@dataclass(frozen=True)
class ImageRow:
    """A row of images that belong together.

    Args:
        name: label of the row.
        images: sRGB in [0, 1].
        captions: one per image.
        note: further explanation, or the reason why there are no images.
    """

    name: str
    images: tuple[Float[Tensor, "3 _ _"], ...] = ()
    captions: tuple[str, ...] = ()
    note: str = ""


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Args:
        title: heading.
        text: explanation of the images.
        rows: the images.
        file: name of the contact sheet's file, without extension; empty for no sheet.
    """

    title: str
    text: str
    rows: tuple[ImageRow, ...] = ()
    file: str = ""


def sheet(section: Section) -> Image.Image:
    """Contact sheet of a section; a row without images is labelled with the reason."""
    columns = max(len(row.images) for row in section.rows)
    example = next(row for row in section.rows if row.images)
    same_captions = all(row.captions == example.captions for row in section.rows if row.images)
    titles = example.captions if same_captions else tuple(str(i + 1) for i in range(columns))
    blank = torch.full_like(_enlarge_and_pad(example.images[0]), BACKGROUND)
    rows = [[*map(_enlarge_and_pad, row.images), *[blank] * (columns - len(row.images))] for row in section.rows]
    names = [row.name if row.images else f"{row.name}: {row.note}" for row in section.rows]
    return contact_sheet(rows, titles, names, height=blank.shape[1])


def write_page(
    path: Path, title: str, subtitle: str, sections: Sequence[Section], provenance: Mapping[str, str]
) -> None:
    """Write one self-contained page, atomically.

    Args:
        path: the HTML file.
        title: the page's title.
        subtitle: a line below the title.
        sections: sections of the page.
        provenance: origin of the images.

    Raises:
        InputError: the file cannot be written.
    """
    count = sum(len(row.images) for section in sections for row in section.rows)
    budget = PAGE_BYTES // max(count, 40)
    values = {
        "title": title,
        "policy": "img-src data:; style-src 'unsafe-inline'",
        "subtitle": subtitle,
        "sections": sections,
        "uri": lambda image: data_uri(image, budget, EDGE),
        "tiny": EDGE // 2,
        "provenance": provenance,
        "written": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }
    write_text(path, render("simulation.html", values))


def _enlarge_and_pad(image: Float[Tensor, "3 _ _"]) -> Float[Tensor, "3 _ _"]:
    """Enlarge an image by an integer factor and pad it if it is too small for the text of a sheet."""
    image = image.detach().cpu().float()
    factor = max(1, MIN_WIDTH // max(image.shape[1:]))
    enlarged = image.repeat_interleave(factor, 1).repeat_interleave(factor, 2)
    right, below = max(0, MIN_WIDTH - enlarged.shape[2]), max(0, MIN_HEIGHT - enlarged.shape[1])
    return F.pad(enlarged, (0, right, 0, below), value=BACKGROUND)
