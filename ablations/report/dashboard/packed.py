"""Everything that the page shows as one compact value: each record once, in columns, texts numbered.

``records`` holds one list a field; fields that repeat are indices into ``pools``. ``tables`` point at records by
index. What cannot be known here is stated with its reason, so that the page decides nothing.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from ablations.report.dashboard.folder import Listed
from ablations.study.lines import Line, Number, baselines, table_lines
from ablations.study.results import Results, block_of
from gaussian_enhancer.metrics.records import MISSING, Record
from gaussian_enhancer.report.quantities import Quantity, quantities

POOLED = ("kind", "run", "scene", "splat", "view", "variant", "protocol", "commit", "machine", "time")
"""Fields of a record that repeat; with them size, reasons and sources."""


class NumberedValues:
    """Values numbered in the order in which they came."""

    def __init__(self) -> None:
        self.numbers: dict[Any, int] = {}

    def number(self, value: Any) -> int:
        """A value's number; equal values share one."""
        return self.numbers.setdefault(value, len(self.numbers))

    @property
    def values(self) -> list[Any]:
        """The values by number."""
        return list(self.numbers)


def packed_tables(listed: Sequence[Listed]) -> dict[str, Any]:
    """Records, tables and metrics of a folder as plain values.

    Args:
        listed: the tables.
    """
    places: dict[tuple[str, str], int] = {}
    unique: list[tuple[str, Record]] = []
    for one in listed:
        for checksum, record in zip(one.checksums, one.records, strict=True):
            key = (checksum, record.time)
            if key not in places:
                places[key] = len(unique)
                unique.append((checksum, record))
    keys = {name for one in listed for name in one.table.metrics} | {name for _, r in unique for name in r.metrics}
    metrics = quantities(keys)
    return {
        "metrics": [_metric(metric) for metric in metrics],
        **_columns(unique, [metric.key for metric in metrics]),
        "tables": [_table(one, places) for one in listed],
    }


def _metric(metric: Quantity) -> dict[str, Any]:
    return {**dataclasses.asdict(metric), "higher": metric.higher_is_better}


def _columns(unique: Sequence[tuple[str, Record]], metrics: Sequence[str]) -> dict[str, Any]:
    """The records field by field."""
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
    return {
        "pools": {name: pool.values for name, pool in pools.items()},
        "records": {**columns, "values": values},
    }


def _table(one: Listed, places: Mapping[tuple[str, str], int]) -> dict[str, Any]:
    """A description with its lines; records by their place among all."""
    table, records = one.table, one.records
    own = [places[checksum, record.time] for checksum, record in zip(one.checksums, records, strict=True)]
    before, results = baselines(table, records), Results(table, records)
    blocks = NumberedValues()
    return {
        **{name: getattr(table, name) for name in ("name", "title", "kind", "about", "baseline", "finer", "scale")},
        "metrics": table.metrics,
        "splats": table.splats,
        "seeds": table.seeds,
        "rows": {name: _described(dataclasses.asdict(method)) for name, method in table.methods.items()},
        "datasets": {name: dataclasses.asdict(dataset) for name, dataset in table.datasets.items()},
        "absent": one.absent,
        "digest": one.digest,
        "records": own,
        "baseline_of": [[own[place] for place in places_] for places_ in before],
        "block_of": [blocks.number(block_of(table, record)) for record in records],
        "blocks": blocks.values,
        "missing": sum(record.kind == MISSING for record in records),
        "outside": len(results.outside),
        "lines": [_line(line, table.metrics) for line in table_lines(results, records)],
    }


def _described(method: dict[str, Any]) -> dict[str, Any]:
    """A method's description without what it leaves open."""
    return {name: value for name, value in method.items() if value not in ("", (), False) or name in ("title", "role")}


def _line(line: Line, metrics: Sequence[str]) -> dict[str, Any]:
    """A line; its records by their place in the table."""
    return {
        "block": line.block,
        "dataset": line.dataset,
        "row": line.method,
        "statistic": line.statistic,
        "numbers": [_number(line.numbers[metric]) for metric in metrics],
        "records": line.records,
    }


def _number(number: Number) -> dict[str, Any]:
    """A number without what is unknown."""
    return {name: value for name, value in dataclasses.asdict(number).items() if value not in (None, ())}
