"""A table's lines from its records: means, gains over the baseline with intervals, the paper's own beside them."""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from ablations.study.description import TableDescription
from ablations.study.results import Results, block_of
from ablations.study.sample import SceneSplat, ScoreSample
from ablations.study.statistics import Spread, interval, over_seeds
from gaussian_enhancer.metrics.records import MISSING, Record

STATISTICS = {"max": "maximum", "min": "minimum", "mean": "mean", "std": "deviation"}
"""What tables of repeated runs state of a method's gains over trainings, as the paper and as `Spread` name it."""

ALL = "all"
"""Key of the lines over all datasets."""


@dataclass(frozen=True)
class Number:
    """One metric of a line.

    Args:
        value: mean in the metric's unit; None where nothing was measured.
        gain: mean gain over the baseline (or the statistic of it); None for the baseline and where it is unknown.
        low: lower end of the gain's 95% interval; None where there are too few units.
        high: upper end.
        deviation: standard deviation of the gain over trainings (ddof=1); None below two.
        views: views that count.
        scenes: scenes that count.
        seeds: trainings that count; 0 where nothing was trained.
        paper: the paper's value; None where it has none.
        paper_gain: the paper's gain.
        reasons: what is missing, and why.
    """

    value: float | None = None
    gain: float | None = None
    low: float | None = None
    high: float | None = None
    deviation: float | None = None
    views: int = 0
    scenes: int = 0
    seeds: int = 0
    paper: float | None = None
    paper_gain: float | None = None
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Line:
    """One line of a table.

    Args:
        block: splatting method; size where the table is one of cost.
        dataset: key of the dataset; `ALL` for all of several.
        method: the method's name.
        statistic: one of `STATISTICS` in tables of repeated runs, else empty.
        numbers: by metric.
        records: places of the records behind it, those of what is missing among them.
    """

    block: str
    dataset: str
    method: str
    statistic: str = ""
    numbers: Mapping[str, Number] = field(default_factory=dict)
    records: tuple[int, ...] = ()


def table_lines(results: Results, records: Sequence[Record]) -> tuple[Line, ...]:
    """All lines of a table; what is missing is named.

    Args:
        results: the table with its records.
        records: the same records, in the order that places are counted in.
    """
    return tuple(_lines(results, _members(results.study, records)))


def baselines(table: TableDescription, records: Sequence[Record]) -> tuple[tuple[int, ...], ...]:
    """For each record the places of the baseline's records that its gain is over; empty where there is none.

    Mostly one, of the same scene, splat, view and seed. A baseline without a seed stands beside every seed; a method
    without one is held against the mean over the baseline's seeds.
    """
    at: dict[tuple[str, str, str], dict[int | None, int]] = {}
    for index, record in enumerate(records):
        if record.kind == "quality" and record.variant == table.baseline:
            at.setdefault((record.scene, record.splat, record.view), {})[record.seed] = index

    def before(record: Record) -> tuple[int, ...]:
        if record.kind != "quality" or record.variant == table.baseline:
            return ()
        found = at.get((record.scene, record.splat, record.view), {})
        same = found.get(record.seed, found.get(None))
        if same is not None:
            return (same,)
        return tuple(found.values()) if record.seed is None else ()

    return tuple(before(record) for record in records)


def _lines(results: Results, members: Mapping[tuple[str, str], Sequence[tuple[int, str]]]) -> Iterator[Line]:
    table = results.study
    for block in results.blocks:
        for key, scenes in _datasets(results, block):
            for method in table.methods:
                if table.kind == "repeats" and method == table.baseline:
                    continue
                both = [*members.get((block, method), ()), *members.get(("", method), ())]
                line = Line(block, key, method, records=tuple(place for place, scene in both if scene in scenes))
                if table.kind == "repeats":
                    yield from _repeated(results, line, scenes)
                else:
                    numbers = {metric: _number(results, line, scenes, metric) for metric in table.metrics}
                    yield dataclasses.replace(line, numbers=numbers)


def _members(table: TableDescription, records: Sequence[Record]) -> dict[tuple[str, str], list[tuple[int, str]]]:
    """Places and scenes of the records by block and method."""
    kinds = ("cost" if table.kind == "cost" else "quality", MISSING)
    found: dict[tuple[str, str], list[tuple[int, str]]] = {}
    for place, record in enumerate(records):
        if record.kind in kinds:
            found.setdefault((block_of(table, record), record.variant), []).append((place, record.scene))
    return found


def _datasets(results: Results, block: str) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Every dataset's key and scenes, and all together where there are several, or none, or the block is a size."""
    datasets = {} if results.costs else results.study.datasets
    for key, dataset in datasets.items():
        yield key, dataset.scenes
    if len(datasets) != 1 and results.study.kind != "repeats":
        yield ALL, results.scenes_of(block)


def _number(results: Results, line: Line, scenes: Sequence[str], metric: str) -> Number:
    """One metric of a line that states means."""
    table = results.study
    values = results.values(line.block, line.method, metric, scenes)
    paper, paper_gain = _paper(table, line, metric)
    value = _known(values.mean())
    if line.method == table.baseline or table.kind == "cost":
        return _counted(values, Number(value=value, paper=paper, paper_gain=paper_gain))
    gains = results.gains(line.block, line.method, metric, None, scenes)
    low, high = interval(gains)
    spread = over_seeds(gains)
    number = Number(value, _known(gains.mean()), _known(low), _known(high), _known(spread.deviation))
    return _counted(gains, dataclasses.replace(number, paper=paper, paper_gain=paper_gain))


def _repeated(results: Results, line: Line, scenes: Sequence[str]) -> Iterator[Line]:
    """The statistics of a method's gains over trainings."""
    table = results.study
    gains = {metric: results.gains(line.block, line.method, metric, None, scenes) for metric in table.metrics}
    spreads = {metric: over_seeds(sample) for metric, sample in gains.items()}
    for statistic in STATISTICS:
        told = dataclasses.replace(line, statistic=statistic)
        numbers = {metric: _repeat(gains[metric], spreads[metric], table, told, metric) for metric in table.metrics}
        yield dataclasses.replace(told, numbers=numbers)


def _repeat(gains: ScoreSample, spread: Spread, table: TableDescription, line: Line, metric: str) -> Number:
    found = _known(getattr(spread, STATISTICS[line.statistic]))
    _, paper_gain = _paper(table, line, metric)
    number = _counted(gains, Number(gain=found, paper_gain=paper_gain))
    left_out = tuple(f"left out, {name}: {reason}" for name, reason in spread.left_out.items())
    few = (f"{spread.count} of the 2 trainings that a deviation needs",) if found is None and spread.count else ()
    return dataclasses.replace(number, reasons=(*few, *left_out, *number.reasons))


def _counted(sample: ScoreSample, number: Number) -> Number:
    """The number with its n, and what is missing in words."""
    scenes, _, views = sample.counts()
    seeds = len({seed for _, seed in sample.values if seed is not None})
    reasons = [f"{_unit(*unit)}: {reason}" for unit, reason in sample.missing.items()]
    for unit, views_ in sample.unknown.items():
        told = list(views_.values())
        reasons += [f"{_unit(*unit)}: {text} ({told.count(text)} views)" for text in dict.fromkeys(told)]
    return dataclasses.replace(number, views=views, scenes=scenes, seeds=seeds, reasons=tuple(reasons))


def _unit(pair: SceneSplat, seed: int | None) -> str:
    return pair[0] if seed is None else f"{pair[0]}, seed {seed}"


def _paper(table: TableDescription, line: Line, metric: str) -> tuple[float | None, float | None]:
    """The paper's value and gain. Its blocks are those of one dataset, and stand beside all where a scale has more."""
    place = table.metrics.index(metric)
    if table.kind == "repeats":
        if table.methods[line.method].mode == "ours":
            return None, None
        return None, _at(table.paper.get(line.dataset, {}).get(line.statistic), place)
    if len(table.datasets) > 1 and line.dataset != ALL:
        return None, None
    block = table.paper.get(line.block, {})
    value, first = _at(block.get(line.method), place), _at(block.get(table.baseline), place)
    if table.kind == "cost" or line.method == table.baseline or value is None or first is None:
        return value, None
    return value, value - first


def _at(values: Sequence[float] | None, place: int) -> float | None:
    return values[place] if values is not None and place < len(values) else None


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
