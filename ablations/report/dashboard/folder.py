"""Reads a folder of the suite's results: descriptions with their records, each record with its checksum."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ablations.study.description import TableDescription, read_description
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import file_digest
from gaussian_enhancer.metrics.records import Record, read_checked

KINDS = ("table", "figure")


@dataclass(frozen=True)
class TableRecords:
    """A table's description with its records.

    Args:
        table: its description.
        records: its records, in the file's order.
        checksums: of each record, as its line states it.
        digest: SHA-256 of the file of records; empty if there is none.
        absent: why there are no records; empty otherwise.
    """

    table: TableDescription
    records: tuple[Record, ...] = ()
    checksums: tuple[str, ...] = ()
    digest: str = ""
    absent: str = ""


def read_folder(folder: str | Path) -> tuple[TableRecords, ...]:
    """Read all tables of a folder by number, then all figures by number, then studies.

    Args:
        folder: has files ``<name>.json`` and ``<name>.jsonl``.

    Raises:
        InputError: the folder is missing or holds no description, a file of records has no description, or a file
            is damaged.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InputError(root, "is no folder", "give the folder of results: docs/results/tables/desk")
    descriptions = sorted(root.glob("*.json"), key=lambda path: _number(path.stem))
    if not descriptions:
        raise InputError(root, "contains no description of a table", "make a table first: gaussian-enhancer tables")
    without_description = sorted({p.stem for p in root.glob("*.jsonl")} - {p.stem for p in descriptions})
    if without_description:
        raise InputError(
            root / f"{without_description[0]}.jsonl", "has no description in its folder", "make the table again"
        )
    return tuple(_read_table(path) for path in descriptions)


def all_records(tables: Sequence[TableRecords]) -> tuple[Record, ...]:
    """The records of all tables; a record in several tables is repeated."""
    return tuple(record for table_listing in tables for record in table_listing.records)


def _read_table(path: Path) -> TableRecords:
    table = read_description(path)
    source = path.with_suffix(".jsonl")
    if not source.is_file():
        return TableRecords(table, absent="no records yet: make the table")
    checked = read_checked(source)
    checksums, records = tuple(checksum for checksum, _ in checked), tuple(record for _, record in checked)
    return TableRecords(table, records, checksums, file_digest(source))


def _number(name: str) -> tuple[int, str, int]:
    """Sort key: ``table_2`` before ``table_10``, tables before figures, figures before studies."""
    head, _, tail = name.rpartition("_")
    numbered = tail.isdigit() and head in KINDS
    return (KINDS.index(head), head, int(tail)) if numbered else (len(KINDS), name, 0)
