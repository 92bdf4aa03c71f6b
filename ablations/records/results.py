"""A table's records by block, row, scene, seed and view: what its description asks for, and what of it is there.

Rows are paired over the same scene, splat, seed and view. A row that needs no training (the raw render, bicubic
enlargement, shipped weights) has no seed and stands beside every seed of a row that does.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

from ablations.records.description import Table
from ablations.records.gains import Study
from ablations.records.statistics import Sample, Unit
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.comparison import Pair
from gaussian_enhancer.metrics.records import MISSING, Record

NetworkInput = dict[str, float]
Reasons = dict[str, str]


def block_of(table: Table, record: Record) -> str:
    """The block of its table that a record belongs to; empty where it is that of none.

    The block is the record's splat. Tables of cost have their output sizes as blocks: a record belongs to the size that
    its ``scene``, ``splat`` or ``view`` names (the paper's "1k"), else to its width and height.

    Args:
        table: its description.
        record: one of its records.
    """
    if table.kind != "cost":
        return record.splat
    names = (record.scene, record.splat, record.view)
    named = next((name for name in names if name in table.paper or name in table.datasets), "")
    return named or (f"{record.size[0]} x {record.size[1]}" if any(record.size) else "")


class Results:
    """The records of one table, by `block_of`; in tables of cost a reason without a size stands for every size.

    Args:
        table: its description.
        records: its records, in any order.

    Raises:
        InputError: a view was measured twice.
    """

    def __init__(self, table: Table, records: Iterable[Record]) -> None:
        self.table = table
        self.costs = table.kind == "cost"
        measured = [_placed(table, record) for record in records if record.kind != MISSING]
        gaps = [_placed(table, record) for record in records if record.kind == MISSING]
        self.blocks = self._blocks([*measured, *gaps])
        gaps = [replace(gap, splat=block) for gap in gaps for block in ([gap.splat] if gap.splat else self.blocks)]
        named = [scene for dataset in table.datasets.values() for scene in dataset.scenes]
        self.scenes = tuple(dict.fromkeys(named)) or tuple(sorted({record.scene for record in measured}))
        self.learning = {row: self._seeds(row, measured) for row in table.rows}
        self.records = _ordered(record for record in measured if self._asked(record))
        self.outside = _ordered(record for record in measured if not self._asked(record))
        _refuse_twice(self.records)
        seeds = {None, *(seed for found in self.learning.values() for seed in found)}
        self._studies = {seed: self._study(seed, [*self.records, *_ordered(gaps)]) for seed in seeds}

    def scenes_of(self, block: str) -> tuple[str, ...]:
        """The scenes that a block asks for: all, but a size that is a scene itself asks for that one alone."""
        return (block,) if self.costs and block in self.scenes else self.scenes

    def values(self, block: str, row: str, metric: str, scenes: Sequence[str] | None = None) -> Sample:
        """A row's numbers in one block, by scene, seed and view."""
        return self._sample(block, row, None, metric, scenes)

    def gains(
        self, block: str, row: str, metric: str, over: str | None = None, scenes: Sequence[str] | None = None
    ) -> Sample:
        """A row's gains over the baseline, or over another row, on the same scenes, seeds and views."""
        return self._sample(block, row, over or self.table.baseline, metric, scenes)

    def _sample(self, block: str, row: str, over: str | None, metric: str, scenes: Sequence[str] | None) -> Sample:
        scenes = self.scenes_of(block) if scenes is None else tuple(scenes)
        seeds = self.learning[row] or (self.learning[over] if over else ()) or (None,)
        values: dict[Unit, NetworkInput] = {}
        missing: dict[Unit, str] = {}
        unknown: dict[Unit, Reasons] = {}
        for unit in [(scene, seed) for scene in scenes for seed in seeds]:
            numbers, reasons = self._unit(unit, block, row, over, metric)
            if numbers:
                values[unit] = numbers
                unknown.update({unit: reasons} if reasons else {})
            else:
                missing[unit] = "; ".join(dict.fromkeys(reasons.values()))
        return Sample(tuple(scenes), seeds, values, missing, unknown)

    def _unit(self, unit: Unit, block: str, row: str, over: str | None, metric: str) -> tuple[NetworkInput, Reasons]:
        """Finite numbers by view, and the reasons of the other views; all reasons where the row is missing."""
        cell, study = (unit[0], block), self._studies[unit[1]]
        for name in (row, over):
            if name and (reason := study.why_missing(cell, name)):
                return {}, {"": reason if name == row else f"{name} is missing: {reason}"}
        after = study.records[cell, row]
        before = study.records[cell, over] if over else {}
        numbers, reasons = {}, {}
        for view in sorted({*after, *before}):
            number, reason = _number(after.get(view), before.get(view), (row, over), metric)
            if reason:
                reasons[view] = reason
            else:
                numbers[view] = number
        return numbers, reasons

    def _study(self, seed: int | None, records: Iterable[Record]) -> Study:
        """The records of one seed, with those that need none; a missing row without a seed is missing at every one."""

        def belongs(record: Record) -> bool:
            return record.seed in (seed, None) if record.kind == MISSING else record.seed == self._seed_of(record, seed)

        own = [replace(r, kind="quality" if r.kind == "cost" else r.kind) for r in records if belongs(r)]
        return Study(own, self.table.baseline)

    def _seed_of(self, record: Record, seed: int | None) -> int | None:
        return seed if self.learning.get(record.variant) else None

    def _blocks(self, records: Sequence[Record]) -> tuple[str, ...]:
        if not self.costs:
            return self.table.splats
        found = sorted({(record.size, record.splat) for record in records if record.splat})
        sizes = (name for name, dataset in self.table.datasets.items() if dataset.scenes == (name,))
        return tuple(dict.fromkeys([*self.table.paper, *sizes, *(block for _, block in found)]))

    def _seeds(self, row: str, records: Sequence[Record]) -> tuple[int, ...]:
        """The seeds of a row's trainings; none where it needs none. Cost is that of the seeds that were timed."""
        found = {record.seed for record in records if record.variant == row and record.seed is not None}
        if self.costs:
            return tuple(sorted(found))
        return self.table.seeds if self.table.rows[row].train or found else ()

    def _asked(self, record: Record) -> bool:
        """Whether the description asks for a record."""
        seeds = self.learning.get(record.variant)
        placed = record.scene in self.scenes and record.splat in self.blocks
        own = record.kind == ("cost" if self.costs else "quality")
        return own and placed and seeds is not None and record.seed in (seeds or (None,))


def _placed(table: Table, record: Record) -> Record:
    """The record with its block as ``splat``."""
    return replace(record, splat=block_of(table, record))


def _number(
    after: Record | None, before: Record | None, names: tuple[str, str | None], metric: str
) -> tuple[float, str]:
    """A view's number, or gain where there is a second row; NaN and the reason where there is none."""
    row, over = names
    if after is None or (before is None and over):
        return math.nan, f"not measured as {row if after is None else over}"
    number = Pair(before, after).gain(metric) if before else after.metrics.get(metric)
    if number is None:
        records = [record for record in (after, before) if record is not None and record.metrics.get(metric) is None]
        return math.nan, records[0].reasons.get(metric, f"{metric} was not measured")
    if not math.isfinite(number):
        return math.nan, f"{metric} is not finite"
    return number, ""


def _ordered(records: Iterable[Record]) -> list[Record]:
    """In an order of their own, whatever that of the file."""
    return sorted(records, key=lambda r: (r.scene, r.splat, r.variant, r.seed or 0, r.view, r.time, repr(r)))


def _refuse_twice(records: Sequence[Record]) -> None:
    for one, next_ in pairwise(records):
        names = [(r.scene, r.splat, r.variant, r.seed, r.view) for r in (one, next_)]
        if names[0] == names[1]:
            place = " / ".join(part for part in (one.scene, one.splat, one.view) if part)
            received = f"was measured twice as {one.variant!r}" + ("" if one.seed is None else f" with seed {one.seed}")
            raise InputError(place, received, "give one record of each")
