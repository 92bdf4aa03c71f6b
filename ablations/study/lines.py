"""Computes a table's lines from its records: means, gains over the baseline with intervals, and the paper's values."""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from ablations.study.description import TableDescription
from ablations.study.results import Results, block_of
from ablations.study.sample import SceneSplat, ScoreSample
from ablations.study.statistics import Spread, interval, spread_over_seeds
from gaussian_enhancer.metrics.records import MISSING, Record

STATISTICS = {"max": "maximum", "min": "minimum", "mean": "mean", "std": "deviation"}
"""Statistics of a method's gains over trainings in tables of repeated runs: the paper's name and that of `Spread`."""

ALL = "all"
"""Value of `Line.dataset` for lines over all datasets."""


@dataclass(frozen=True)
class Number:
    """One metric of a line.

    Args:
        value: mean in the metric's unit; None if nothing was measured.
        gain: mean gain over the baseline, or a statistic of it; None for the baseline and if it is unknown.
        low: lower end of the gain's 95% interval; None for too few units.
        high: upper end of that interval.
        deviation: standard deviation of the gain over trainings (ddof=1); None for fewer than two.
        views: number of views in the mean.
        scenes: number of scenes in the mean.
        seeds: number of trainings in the mean; 0 for a method without training.
        paper: the paper's value; None if it has none.
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
        block: splatting method; output size in tables of cost.
        dataset: key of the dataset; `ALL` for a mean over several.
        method: the method's name.
        statistic: one of `STATISTICS` in tables of repeated runs, else empty.
        numbers: by metric.
        records: indices of the records behind the line, including those of missing methods.
    """

    block: str
    dataset: str
    method: str
    statistic: str = ""
    numbers: Mapping[str, Number] = field(default_factory=dict)
    records: tuple[int, ...] = ()


def table_lines(results: Results, records: Sequence[Record]) -> tuple[Line, ...]:
    """All lines of a table, with the reasons of missing numbers.

    Args:
        results: the table with its records.
        records: the same records, in the order to which `Line.records` refers.
    """
    return tuple(_lines(results, _records_by_block(results.study, records)))


def match_baselines(table: TableDescription, records: Sequence[Record]) -> tuple[tuple[int, ...], ...]:
    """For each record, the indices of the baseline's records that its gain is computed against; empty if none.

    Usually this is one record, of the same scene, splat, view and seed. A baseline without a seed is compared with
    every seed. A method without a seed is compared with the mean over the baseline's seeds.
    """
    baseline_indices: dict[tuple[str, str, str], dict[int | None, int]] = {}
    for index, record in enumerate(records):
        if record.kind == "quality" and record.variant == table.baseline:
            baseline_indices.setdefault((record.scene, record.splat, record.view), {})[record.seed] = index

    def before(record: Record) -> tuple[int, ...]:
        if record.kind != "quality" or record.variant == table.baseline:
            return ()
        by_seed = baseline_indices.get((record.scene, record.splat, record.view), {})
        matching = by_seed.get(record.seed, by_seed.get(None))
        if matching is not None:
            return (matching,)
        return tuple(by_seed.values()) if record.seed is None else ()

    return tuple(before(record) for record in records)


def _lines(results: Results, members: Mapping[tuple[str, str], Sequence[tuple[int, str]]]) -> Iterator[Line]:
    table = results.study
    for block in results.blocks:
        for key, scenes in _datasets(results, block):
            for method in table.methods:
                if table.kind == "repeats" and method == table.baseline:
                    continue
                located = [*members.get((block, method), ()), *members.get(("", method), ())]
                empty_line = Line(
                    block, key, method, records=tuple(index for index, scene in located if scene in scenes)
                )
                if table.kind == "repeats":
                    yield from _statistic_lines(results, empty_line, scenes)
                else:
                    numbers = {metric: _number(results, empty_line, scenes, metric) for metric in table.metrics}
                    yield dataclasses.replace(empty_line, numbers=numbers)


def _records_by_block(
    table: TableDescription, records: Sequence[Record]
) -> dict[tuple[str, str], list[tuple[int, str]]]:
    """Indices and scenes of the records, by block and method."""
    kinds = ("cost" if table.kind == "cost" else "quality", MISSING)
    members: dict[tuple[str, str], list[tuple[int, str]]] = {}
    for index, record in enumerate(records):
        if record.kind in kinds:
            members.setdefault((block_of(table, record), record.variant), []).append((index, record.scene))
    return members


def _datasets(results: Results, block: str) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Key and scenes of every dataset, then of all together unless there is exactly one dataset.

    Tables of cost have no datasets; tables of repeated runs have no lines over all of them.
    """
    datasets = {} if results.costs else results.study.datasets
    for key, dataset in datasets.items():
        yield key, dataset.scenes
    if len(datasets) != 1 and results.study.kind != "repeats":
        yield ALL, results.scenes_of(block)


def _number(results: Results, line: Line, scenes: Sequence[str], metric: str) -> Number:
    """One metric of a line of means."""
    table = results.study
    values = results.values(line.block, line.method, metric, scenes)
    paper, paper_gain = _paper(table, line, metric)
    value = _finite_or_none(values.mean())
    if line.method == table.baseline or table.kind == "cost":
        return _with_counts(values, Number(value=value, paper=paper, paper_gain=paper_gain))
    gains = results.gains(line.block, line.method, metric, None, scenes)
    statistics = (gains.mean(), *interval(gains), spread_over_seeds(gains).deviation)
    gain, low, high, deviation = map(_finite_or_none, statistics)
    return _with_counts(gains, Number(value, gain, low, high, deviation, paper=paper, paper_gain=paper_gain))


def _statistic_lines(results: Results, line: Line, scenes: Sequence[str]) -> Iterator[Line]:
    """One line for each statistic of a method's gains over trainings."""
    table = results.study
    gains = {metric: results.gains(line.block, line.method, metric, None, scenes) for metric in table.metrics}
    spreads = {metric: spread_over_seeds(sample) for metric, sample in gains.items()}
    for statistic in STATISTICS:
        statistic_line = dataclasses.replace(line, statistic=statistic)
        numbers = {
            metric: _statistic_number(gains[metric], spreads[metric], table, statistic_line, metric)
            for metric in table.metrics
        }
        yield dataclasses.replace(statistic_line, numbers=numbers)


def _statistic_number(gains: ScoreSample, spread: Spread, table: TableDescription, line: Line, metric: str) -> Number:
    value = _finite_or_none(getattr(spread, STATISTICS[line.statistic]))
    _, paper_gain = _paper(table, line, metric)
    number = _with_counts(gains, Number(gain=value, paper_gain=paper_gain))
    left_out = tuple(f"left out, {name}: {reason}" for name, reason in spread.left_out.items())
    too_few = (f"{spread.count} of the 2 trainings that a deviation needs",) if value is None and spread.count else ()
    return dataclasses.replace(number, reasons=(*too_few, *left_out, *number.reasons))


def _with_counts(sample: ScoreSample, number: Number) -> Number:
    """The number with its sample sizes and the reasons of missing values."""
    scenes, _, views = sample.counts()
    seeds = len({seed for _, seed in sample.values if seed is not None})
    reasons = [f"{_unit(*unit)}: {reason}" for unit, reason in sample.missing.items()]
    for unit, unknown_views in sample.unknown.items():
        reason_texts = list(unknown_views.values())
        reasons += [
            f"{_unit(*unit)}: {text} ({reason_texts.count(text)} views)" for text in dict.fromkeys(reason_texts)
        ]
    return dataclasses.replace(number, views=views, scenes=scenes, seeds=seeds, reasons=tuple(reasons))


def _unit(pair: SceneSplat, seed: int | None) -> str:
    return pair[0] if seed is None else f"{pair[0]}, seed {seed}"


def _paper(table: TableDescription, line: Line, metric: str) -> tuple[float | None, float | None]:
    """The paper's value and gain.

    A block of the paper is one dataset. If a scale has several, its values go with the line over all of them.
    """
    column = table.metrics.index(metric)
    if table.kind == "repeats":
        if table.methods[line.method].mode == "ours":
            return None, None
        return None, _at(table.paper.get(line.dataset, {}).get(line.statistic), column)
    if len(table.datasets) > 1 and line.dataset != ALL:
        return None, None
    block = table.paper.get(line.block, {})
    value, baseline_value = _at(block.get(line.method), column), _at(block.get(table.baseline), column)
    if table.kind == "cost" or line.method == table.baseline or value is None or baseline_value is None:
        return value, None
    return value, value - baseline_value


def _at(values: Sequence[float] | None, index: int) -> float | None:
    return values[index] if values is not None and index < len(values) else None


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
