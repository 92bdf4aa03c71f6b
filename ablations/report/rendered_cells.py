"""A printed table before Markdown or LaTeX: cells in blocks under columns, and numbered notes."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Piece:
    """One printed cell.

    Args:
        text: plain.
        best: whether it is the best of its column in its block.
        notes: numbers of the notes that it refers to.
    """

    text: str
    best: bool = False
    notes: tuple[int, ...] = ()


@dataclass(frozen=True)
class Block:
    """Lines under one heading."""

    title: str
    lines: tuple[tuple[Piece, ...], ...]


@dataclass(frozen=True)
class Sheet:
    """A printed table.

    Args:
        columns: their headings; directions as arrows.
        blocks: the lines.
        notes: why something is missing; the first has the number 1.
    """

    columns: tuple[str, ...]
    blocks: tuple[Block, ...]
    notes: tuple[str, ...]


class Notes:
    """Numbered reasons why something is missing, each with the places where it applies."""

    def __init__(self) -> None:
        self._places: dict[str, dict[str, dict[str, None]]] = {}

    def number(self, where: str, told: str) -> int:
        """A reason's number, counted from 1; where it applies is remembered.

        Args:
            where: block and row.
            told: as lines tell it: scene and seed, a colon, the reason.
        """
        place, found, reason = told.partition(": ")
        reason, place = (reason, place) if found else (told, "")
        self._places.setdefault(reason, {}).setdefault(where, {})[place] = None
        return list(self._places).index(reason) + 1

    def texts(self) -> tuple[str, ...]:
        """The notes in the order of their numbers."""
        return tuple(f"{reason}; in {_listed(rows)}" for reason, rows in self._places.items())


def _listed(rows: Mapping[str, Mapping[str, None]]) -> str:
    """Rows, each with its scenes and seeds in brackets."""
    places = {row: "; ".join(filter(None, found)) for row, found in rows.items()}
    return ", ".join(f"{row} ({found})" if found else row for row, found in places.items())
