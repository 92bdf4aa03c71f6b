"""Paired comparison of two variants from records, and its tables."""

import csv
import io
import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER, Record

ViewKey = tuple[str, str, str]
"""Scene, splat and image name, by which the records of two variants are matched."""


@dataclass(frozen=True)
class VariantPair:
    """One view under two variants."""

    baseline: Record
    variant: Record

    def gain(self, metric: str) -> float | None:
        """Variant minus baseline in the metric's unit; None if either is missing, NaN if both are infinite."""
        before, after = self.baseline.metrics.get(metric), self.variant.metrics.get(metric)
        return None if before is None or after is None else after - before


@dataclass(frozen=True)
class Comparison:
    """One metric over all views of a group.

    Args:
        metric: its name.
        baseline: mean of the baseline over the views with a finite gain.
        variant: mean of the variant over the same views.
        gain: mean of variant minus baseline.
        deviation: standard deviation of the gain over views (ddof=1); NaN below two views.
        count: number of views with a finite gain.
        left_out: the other views, each with its reason.
        worst: the view with the worst gain; empty if the metric has no better direction or no view has a finite gain.
        worst_gain: the gain of that view; NaN if there is none.
    """

    metric: str
    baseline: float
    variant: float
    gain: float
    deviation: float
    count: int
    left_out: dict[str, str]
    worst: str
    worst_gain: float


@dataclass(frozen=True)
class Table:
    """A table of formatted cells."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """The table as GitHub Markdown, pipes in cells escaped."""
        lines = [self.columns, tuple("---" for _ in self.columns), *self.rows]
        return "".join("| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |\n" for line in lines)

    def csv(self) -> str:
        """The table as comma-separated values with a header line."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([self.columns, *self.rows])
        return text.getvalue()


def pair_records(
    records: Iterable[Record], baseline: str = "raw", variant: str = "enhanced"
) -> tuple[VariantPair, ...]:
    """Match the records of two variants by scene, splat and view.

    Raises:
        InputError: a view has only one of the variants, or one of them twice, or no view has either.
    """
    by_variant: dict[str, dict[ViewKey, Record]] = {baseline: {}, variant: {}}
    for record in records:
        key = (record.scene, record.splat, record.view)
        if record.kind != "quality" or record.variant not in by_variant:
            continue
        if key in by_variant[record.variant]:
            raise InputError(_view_name(key), f"was measured twice as {record.variant!r}", "give one record of each")
        by_variant[record.variant][key] = record
    unpaired = sorted(set(by_variant[baseline]) ^ set(by_variant[variant]))
    if unpaired:
        has, lacks = (baseline, variant) if unpaired[0] in by_variant[baseline] else (variant, baseline)
        raise InputError(_view_name(unpaired[0]), f"was measured as {has!r} but not as {lacks!r}", "measure both")
    if not by_variant[baseline]:
        raise InputError("records", f"hold no view measured as {baseline!r} and {variant!r}", "measure both first")
    return tuple(
        VariantPair(by_variant[baseline][key], by_variant[variant][key]) for key in sorted(by_variant[baseline])
    )


def metrics_of(pairs: Sequence[VariantPair]) -> tuple[str, ...]:
    """The metrics of the records: first those in `HIGHER_IS_BETTER`, in its order, then the others by name."""
    return _ordered_metrics({name for pair in pairs for name in (*pair.baseline.metrics, *pair.variant.metrics)})


def compare(pairs: Sequence[VariantPair], metric: str) -> Comparison:
    """Mean gain, deviation and worst view of one metric; views without a finite gain are listed with their reasons."""
    gains = {i: gain for i, pair in enumerate(pairs) if math.isfinite(gain := _nan_if_missing(pair.gain(metric)))}
    values = list(gains.values())
    better = HIGHER_IS_BETTER.get(metric)
    worst = min(gains, key=lambda i: gains[i] if better else -gains[i]) if gains and better is not None else None
    return Comparison(
        metric=metric,
        baseline=_mean([_nan_if_missing(pairs[i].baseline.metrics[metric]) for i in gains]),
        variant=_mean([_nan_if_missing(pairs[i].variant.metrics[metric]) for i in gains]),
        gain=_mean(values),
        deviation=statistics.stdev(values) if len(values) > 1 else math.nan,
        count=len(values),
        left_out={pair.baseline.view: _reason(pair, metric) for i, pair in enumerate(pairs) if i not in gains},
        worst="" if worst is None else pairs[worst].baseline.view,
        worst_gain=math.nan if worst is None else gains[worst],
    )


def gain_table(pairs: Sequence[VariantPair]) -> Table:
    """One row per scene, splat and metric: baseline, variant, gain, its deviation, views, worst view."""
    groups: dict[tuple[str, str], list[VariantPair]] = {}
    for pair in pairs:
        groups.setdefault((pair.baseline.scene, pair.baseline.splat), []).append(pair)
    rows = []
    for (scene, splat), members in groups.items():
        for metric in metrics_of(members):
            comparison = compare(members, metric)
            numbers = (comparison.baseline, comparison.variant, comparison.gain, comparison.deviation)
            worst_gain = format_value(metric, comparison.worst_gain, signed=True)
            worst = f"{comparison.worst} ({worst_gain})" if comparison.worst else ""
            cells = [format_value(metric, value, signed=i == 2) for i, value in enumerate(numbers)]
            note = "; ".join(sorted(set(comparison.left_out.values())))
            rows.append((scene, splat, metric, *cells, f"{comparison.count} of {len(members)}", worst, note))
    columns = ("scene", "splat", "metric", "baseline", "variant", "gain", "sd", "n", "worst view", "left out")
    return Table(columns, tuple(rows))


def mean_table(records: Sequence[Record]) -> Table:
    """One row per scene, splat, variant and metric: mean, standard deviation over views, number of views."""
    groups: dict[tuple[str, str, str], list[Record]] = {}
    for record in records:
        groups.setdefault((record.scene, record.splat, record.variant), []).append(record)
    rows = []
    for key, members in groups.items():
        for metric in _ordered_metrics({name for record in members for name in record.metrics}):
            values = [_nan_if_missing(record.metrics.get(metric)) for record in members]
            finite = [value for value in values if math.isfinite(value)]
            deviation = statistics.stdev(finite) if len(finite) > 1 else math.nan
            equal_count = sum(value == math.inf for value in values)
            notes = {record.reasons.get(metric, "") for record in members} - {""}
            notes |= {f"{equal_count} equal to the photo"} if equal_count else set()
            note = "; ".join(sorted(notes))
            cells = format_value(metric, _mean(finite)), format_value(metric, deviation)
            rows.append((*key, metric, *cells, f"{len(finite)} of {len(members)}", note))
    return Table(("scene", "splat", "variant", "metric", "mean", "sd", "n", "left out"), tuple(rows))


def record_table(records: Sequence[Record]) -> Table:
    """One row per record, one column per metric."""
    names = _ordered_metrics({name for record in records for name in record.metrics})
    rows = [
        (r.scene, r.splat, r.variant, r.view, *(format_value(name, r.metrics.get(name)) for name in names))
        for r in records
    ]
    return Table(("scene", "splat", "variant", "view", *names), tuple(rows))


def view_table(pairs: Sequence[VariantPair]) -> Table:
    """One row per view: for each metric baseline, variant and gain."""
    names = metrics_of(pairs)
    rows = []
    for pair in pairs:
        cells: list[str] = []
        for name in names:
            before, after = pair.baseline.metrics.get(name), pair.variant.metrics.get(name)
            gain = format_value(name, pair.gain(name), signed=True)
            cells += [format_value(name, before), format_value(name, after), gain]
        rows.append((pair.baseline.scene, pair.baseline.splat, pair.baseline.view, *cells))
    metric_columns = [column for name in names for column in (f"{name} baseline", f"{name} variant", f"{name} gain")]
    return Table(("scene", "splat", "view", *metric_columns), tuple(rows))


def format_value(metric: str, value: float | None, signed: bool = False) -> str:
    """Format a number: two decimals for PSNR, time and memory, four for other metrics; empty for None and NaN."""
    if value is None or math.isnan(value):
        return ""
    digits = 2 if metric.startswith(("psnr", "milliseconds", "peak_memory")) else 4
    return f"{value:+.{digits}f}" if signed else f"{value:.{digits}f}"


def _ordered_metrics(names: set[str]) -> tuple[str, ...]:
    ordered = [name for name in HIGHER_IS_BETTER if name in names]
    return (*ordered, *sorted(names.difference(ordered)))


def _nan_if_missing(value: float | None) -> float:
    return math.nan if value is None else value


def _mean(values: Sequence[float]) -> float:
    return statistics.fmean(values) if values else math.nan


def _reason(pair: VariantPair, metric: str) -> str:
    reasons = (pair.baseline.reasons.get(metric), pair.variant.reasons.get(metric))
    return next((reason for reason in reasons if reason), "equal to the photo, or not measured on both")


def _view_name(key: ViewKey) -> str:
    return " / ".join(part for part in key if part)
