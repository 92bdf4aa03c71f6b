"""Diagrams of error over run time beside the page."""

import html
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from gaussian_enhancer.files import whole_file

FOLDER = "diagrams"


@dataclass(frozen=True)
class Diagram:
    """One diagram.

    Args:
        title: its own, unescaped.
        file: address relative to the page.
    """

    title: str
    file: str


def copy_diagrams(source: Path, output: Path) -> tuple[Diagram, ...]:
    """Copy the SVG files of a folder beside the page, by name; none where the folder is not there.

    Args:
        source: where the job tradeoff has written them.
        output: the page's folder.

    Raises:
        InputError: a file cannot be written.
    """
    found = []
    for path in sorted(source.glob("*.svg")):
        with whole_file(output / FOLDER / path.name) as temporary:
            shutil.copyfile(path, temporary)
        found.append(Diagram(_title(path), f"{FOLDER}/{path.name}"))
    return tuple(found)


def _title(path: Path) -> str:
    """The document's title; the file's name where it has none."""
    match = re.search(r"<title>(.*?)</title>", path.read_text(encoding="utf-8"), re.S)
    return html.unescape(match[1]) if match else path.stem
