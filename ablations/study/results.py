"""Looks up the records of a study by scene-splat pair, method, seed and view, and the reasons of missing ones.

Methods are paired over the same scene, splat, seed and view. A method without training (the raw render, bicubic
upsampling, shipped weights) has no seed and is compared with every seed of a trained method.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

from ablations.study.description import TableDescription
from ablations.study.sample import SceneSplat, ScoreSample, Unit
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.comparison import VariantPair
from gaussian_enhancer.metrics.records import MISSING, Record


def block_of(study: TableDescription, record: Record) -> str:
    """The block of the rendered table that a record belongs to; empty if it belongs to none.

    The block is the record's splat. In studies of cost, the blocks are output sizes: a record belongs to the size that
    its ``scene``, ``splat`` or ``view`` names (the paper's "1k"), else to its width and height.

    Args:
        study: its description.
        record: one of its records.
    """
    if study.kind != "cost":
        return record.splat
    names = (record.scene, record.splat, record.view)
    named = next((name for name in names if name in study.paper or name in study.datasets), "")
    return named or (f"{record.size[0]} x {record.size[1]}" if any(record.size) else "")


class Results:
    """The records of one study, in blocks by `block_of`.

    In studies of cost, a record of a missing method without a size applies to every size.

    Args:
        study: its description.
        records: its records, in any order.

    Raises:
        InputError: a view was measured twice.
    """

    def __init__(self, study: TableDescription, records: Iterable[Record]) -> None:
        placed = [replace(record, splat=block_of(study, record)) for record in records]
        self.study, self.costs = study, study.kind == "cost"
        self.pairs: tuple[SceneSplat, ...] = tuple(dict.fromkeys((record.scene, record.splat) for record in placed))
        self.blocks = self._blocks(placed)
        measured_records = [record for record in placed if record.kind != MISSING]
        dataset_scenes = [scene for dataset in study.datasets.values() for scene in dataset.scenes]
        self.scenes = tuple(dict.fromkeys(dataset_scenes)) or tuple(
            sorted({record.scene for record in measured_records})
        )
        self.seeds_by_method = {method: self._seeds(method, measured_records) for method in study.methods}
        self.records = _ordered(record for record in measured_records if self._is_covered(record))
        self.uncovered_records = _ordered(record for record in measured_records if not self._is_covered(record))
        _refuse_duplicates(self.records)
        self.views: dict[tuple[SceneSplat, str, int | None], dict[str, Record]] = {}
        for record in self.records:
            key = ((record.scene, record.splat), record.variant, record.seed)
            self.views.setdefault(key, {})[record.view] = record
        self._reasons = {
            ((gap.scene, block), gap.variant, gap.seed): gap.reasons["row"]
            for gap in _ordered(record for record in placed if record.kind == MISSING)
            for block in ([gap.splat] if gap.splat else self.blocks)
        }

    def scenes_of(self, block: str) -> tuple[str, ...]:
        """The scenes of a block: all scenes, or the block alone in studies of cost whose scenes are output sizes."""
        return (block,) if self.costs and block in self.scenes else self.scenes

    def values(self, block: str, method: str, metric: str, scenes: Sequence[str] | None = None) -> ScoreSample:
        """A method's values in one block, by scene, seed and view."""
        return self.sample(self._pairs(block, scenes), method, metric)

    def gains(
        self, block: str, method: str, metric: str, over: str | None = None, scenes: Sequence[str] | None = None
    ) -> ScoreSample:
        """A method's gains over the baseline or another method, on the same scenes, seeds and views."""
        return self.sample(self._pairs(block, scenes), method, metric, over or self.study.baseline)

    def sample(self, pairs: Sequence[SceneSplat], method: str, metric: str, over: str = "") -> ScoreSample:
        """A method's values in scene-splat pairs, or its gains over another method.

        Args:
            pairs: scene-splat pairs.
            method: name of the method.
            metric: name of the metric.
            over: the method that gains are computed against; empty for the values themselves.
        """
        seeds = self.seeds_by_method[method] or (self.seeds_by_method[over] if over else ()) or (None,)
        values: dict[Unit, dict[str, float]] = {}
        missing: dict[Unit, str] = {}
        unknown: dict[Unit, dict[str, str]] = {}
        for unit in [(pair, seed) for pair in pairs for seed in seeds]:
            numbers, reasons = self._unit(unit, method, over, metric)
            if numbers:
                values[unit] = numbers
                unknown.update({unit: reasons} if reasons else {})
            else:
                missing[unit] = "; ".join(dict.fromkeys(reasons.values()))
        return ScoreSample(tuple(pairs), seeds, values, missing, unknown)

    def missing_reason(self, pair: SceneSplat, method: str, seed: int | None = None) -> str:
        """Why a method was not measured on a scene-splat pair; empty if it was."""
        if (pair, method, self._seed_of(method, seed)) in self.views:
            return ""
        return self._reasons.get((pair, method, seed)) or self._reasons.get((pair, method, None)) or "no record"

    def _pairs(self, block: str, scenes: Sequence[str] | None) -> tuple[SceneSplat, ...]:
        return tuple((scene, block) for scene in (self.scenes_of(block) if scenes is None else scenes))

    def _unit(self, unit: Unit, method: str, over: str, metric: str) -> tuple[dict[str, float], dict[str, str]]:
        """Finite values by view, and the reasons of views without one; the reason alone if a method is missing."""
        pair, seed = unit
        for name in (method, over):
            if name and (reason := self.missing_reason(pair, name, seed)):
                return {}, {"": reason if name == method else f"{name} is missing: {reason}"}
        after = self.views[pair, method, self._seed_of(method, seed)]
        before = self.views[pair, over, self._seed_of(over, seed)] if over else {}
        numbers, reasons = {}, {}
        for view in sorted({*after, *before}):
            number, reason = _number(after.get(view), before.get(view), (method, over), metric)
            if reason:
                reasons[view] = reason
            else:
                numbers[view] = number
        return numbers, reasons

    def _seed_of(self, method: str, seed: int | None) -> int | None:
        return seed if self.seeds_by_method.get(method) else None

    def _blocks(self, records: Sequence[Record]) -> tuple[str, ...]:
        if not self.costs:
            return self.study.splats or tuple(dict.fromkeys(splat for _, splat in self.pairs))
        measured_blocks = sorted({(record.size, record.splat) for record in records if record.splat})
        size_blocks = (name for name, dataset in self.study.datasets.items() if dataset.scenes == (name,))
        return tuple(dict.fromkeys([*self.study.paper, *size_blocks, *(block for _, block in measured_blocks)]))

    def _seeds(self, method: str, records: Sequence[Record]) -> tuple[int, ...]:
        """The seeds of a method's trainings, none for an untrained method; for cost, the seeds that were timed."""
        measured_seeds = {record.seed for record in records if record.variant == method and record.seed is not None}
        if self.costs:
            return tuple(sorted(measured_seeds))
        return self.study.seeds if self.study.methods[method].train or measured_seeds else ()

    def _is_covered(self, record: Record) -> bool:
        """Whether the study's description covers a record."""
        seeds = self.seeds_by_method.get(record.variant)
        in_scope = record.scene in self.scenes and record.splat in self.blocks
        of_study_kind = record.kind == ("cost" if self.costs else "quality")
        return of_study_kind and in_scope and seeds is not None and record.seed in (seeds or (None,))


def _number(after: Record | None, before: Record | None, names: tuple[str, str], metric: str) -> tuple[float, str]:
    """A view's value, or its gain if there is a second method; NaN and the reason if there is none."""
    method, over = names
    if after is None or (before is None and over):
        return math.nan, f"not measured as {method if after is None else over}"
    number = VariantPair(before, after).gain(metric) if before else after.metrics.get(metric)
    if number is None:
        records = [record for record in (after, before) if record is not None and record.metrics.get(metric) is None]
        return math.nan, records[0].reasons.get(metric, f"{metric} was not measured")
    if not math.isfinite(number):
        return math.nan, f"{metric} is not finite"
    return number, ""


def _ordered(records: Iterable[Record]) -> list[Record]:
    """The records sorted, so that the order of the file has no effect."""
    return sorted(records, key=lambda r: (r.scene, r.splat, r.variant, r.seed or 0, r.view, r.time, repr(r)))


def _refuse_duplicates(records: Sequence[Record]) -> None:
    for record, next_ in pairwise(records):
        names = [(r.scene, r.splat, r.variant, r.seed, r.view) for r in (record, next_)]
        if names[0] == names[1]:
            place = " / ".join(part for part in (record.scene, record.splat, record.view) if part)
            received = f"was measured twice as {record.variant!r}" + (
                "" if record.seed is None else f" with seed {record.seed}"
            )
            raise InputError(place, received, "give one record of each")
