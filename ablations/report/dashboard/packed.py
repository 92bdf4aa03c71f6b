"""Packs all tables and records of the page into compact plain values: each record once, column by column.

``records`` has one list per field; fields with repeated values hold indices into ``pools``. ``tables`` refer to records
by index. Missing values are stated with their reasons, so that the page's script decides nothing.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from ablations.report.dashboard.folder import TableRecords
from ablations.study.lines import Line, Number, match_baselines, table_lines
from ablations.study.results import Results, block_of
from gaussian_enhancer.metrics.records import MISSING, Record
from gaussian_enhancer.report.quantities import Quantity, quantities

POOLED = ("kind", "run", "scene", "splat", "view", "variant", "protocol", "commit", "machine", "time")
"""Fields of a record that are stored as indices into ``pools``, as are size, reasons and sources."""


class NumberedValues:
    """Assigns numbers to distinct values, in the order in which they are first seen."""

    def __init__(self) -> None:
        self.numbers: dict[Any, int] = {}

    def number(self, value: Any) -> int:
        """A value's number; equal values share one."""
        return self.numbers.setdefault(value, len(self.numbers))

    @property
    def values(self) -> list[Any]:
        """The values by number."""
        return list(self.numbers)


def packed_tables(tables: Sequence[TableRecords]) -> dict[str, Any]:
    """Records, tables and metrics of a folder, as plain values for the page's script.

    Args:
        tables: the tables.
    """
    index_by_key: dict[tuple[str, str], int] = {}
    unique: list[tuple[str, Record]] = []
    for table_listing in tables:
        for checksum, record in zip(table_listing.checksums, table_listing.records, strict=True):
            key = (checksum, record.time)
            if key not in index_by_key:
                index_by_key[key] = len(unique)
                unique.append((checksum, record))
    keys = {name for table_listing in tables for name in table_listing.table.metrics} | {
        name for _, r in unique for name in r.metrics
    }
    metrics = quantities(keys)
    return {
        "metrics": [_metric(metric) for metric in metrics],
        **_columns(unique, [metric.key for metric in metrics]),
        "tables": [_table(table_listing, index_by_key) for table_listing in tables],
    }


def _metric(metric: Quantity) -> dict[str, Any]:
    return {**dataclasses.asdict(metric), "higher": metric.higher_is_better}


def _columns(unique: Sequence[tuple[str, Record]], metrics: Sequence[str]) -> dict[str, Any]:
    """The records, field by field, with the pools of repeated values."""
    pools = {name: NumberedValues() for name in (*POOLED, "size", "reasons", "sources")}
    columns: dict[str, list[Any]] = {name: [] for name in (*pools, "seed", "checksum")}
    for checksum, record in unique:
        for name in POOLED:
            columns[name].append(pools[name].number(getattr(record, name)))
        columns["size"].append(pools["size"].number(tuple(record.size)))
        for name in ("reasons", "sources"):
            columns[name].append(pools[name].number(tuple(sorted(getattr(record, name).items()))))
        columns["seed"].append(record.seed)
        columns["checksum"].append(checksum)
    values = {name: [record.metrics.get(name) for _, record in unique] for name in metrics}
    return {"pools": {name: pool.values for name, pool in pools.items()}, "records": {**columns, "values": values}}


def _table(listing: TableRecords, index_by_key: Mapping[tuple[str, str], int]) -> dict[str, Any]:
    """A table's description and lines; its records as indices into all records."""
    table, records = listing.table, listing.records
    keys = zip(listing.checksums, (record.time for record in records), strict=True)
    record_indices = [index_by_key[key] for key in keys]
    baseline_indices, results = match_baselines(table, records), Results(table, records)
    blocks = NumberedValues()
    return {
        **{name: getattr(table, name) for name in ("name", "title", "kind", "about", "baseline", "finer", "scale")},
        "metrics": table.metrics,
        "splats": table.splats,
        "seeds": table.seeds,
        "rows": {name: _described(dataclasses.asdict(method)) for name, method in table.methods.items()},
        "datasets": {name: dataclasses.asdict(dataset) for name, dataset in table.datasets.items()},
        "absent": listing.absent,
        "digest": listing.digest,
        "records": record_indices,
        "baseline_of": [[record_indices[place] for place in indices] for indices in baseline_indices],
        "block_of": [blocks.number(block_of(table, record)) for record in records],
        "blocks": blocks.values,
        "missing": sum(record.kind == MISSING for record in records),
        "outside": len(results.uncovered_records),
        "lines": [_line(line, table.metrics) for line in table_lines(results, records)],
    }


def _described(method: dict[str, Any]) -> dict[str, Any]:
    """A method's description without empty values, except its title and role."""
    return {name: value for name, value in method.items() if value not in ("", (), False) or name in ("title", "role")}


def _line(line: Line, metrics: Sequence[str]) -> dict[str, Any]:
    """A line; its records as indices into the table's records."""
    return {
        "block": line.block,
        "dataset": line.dataset,
        "row": line.method,
        "statistic": line.statistic,
        "numbers": [_number(line.numbers[metric]) for metric in metrics],
        "records": line.records,
    }


def _number(number: Number) -> dict[str, Any]:
    """A number without unknown values."""
    return {name: value for name, value in dataclasses.asdict(number).items() if value not in (None, ())}
