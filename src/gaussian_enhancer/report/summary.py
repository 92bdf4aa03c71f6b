"""From the numbers of single views to mean gain, spread, and the view that fared worst."""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from gaussian_enhancer.report.compared import ComparedView
from gaussian_enhancer.report.quantities import DECIDING, Quantity, quantities


@dataclass(frozen=True)
class Summary:
    """One metric over all views that have it.

    Args:
        quantity: the metric.
        raw: mean over the renders.
        enhanced: mean over the enhanced renders.
        gain: mean of enhanced minus raw.
        deviation: standard deviation of the gain over views (ddof=1); NaN for a single view.
        count: views that entered: those where raw and enhanced are both finite.
        left_out: views that have the metric, but not as a finite number (identical images have infinite PSNR).
        improved: views whose gain points the better way.
        worst: index of the view with the poorest gain; None where the metric has no direction or no view.
    """

    quantity: Quantity
    raw: float
    enhanced: float
    gain: float
    deviation: float
    count: int
    left_out: int
    improved: int
    worst: int | None


def gain_of(view: ComparedView, key: str) -> float | None:
    """Enhanced minus raw in the metric's own unit; None where one of them was not measured."""
    if key not in view.metrics_raw or key not in view.metrics_enhanced:
        return None
    return view.metrics_enhanced[key] - view.metrics_raw[key]


def measured(views: Sequence[ComparedView]) -> tuple[Quantity, ...]:
    """The metrics that at least one view has, or gives a reason for not having."""
    keys: set[str] = set()
    for view in views:
        keys |= {*view.metrics_raw, *view.metrics_enhanced, *view.reasons}
    return quantities(keys)


def summarise(views: Sequence[ComparedView], quantity: Quantity) -> Summary:
    """Mean, spread and worst view of one metric."""
    key = quantity.key
    gains = {i: gain for i, view in enumerate(views) if (gain := gain_of(view, key)) is not None}
    finite = {i: gain for i, gain in gains.items() if math.isfinite(gain)}
    values = list(finite.values())
    return Summary(
        quantity=quantity,
        raw=_mean([views[i].metrics_raw[key] for i in finite]),
        enhanced=_mean([views[i].metrics_enhanced[key] for i in finite]),
        gain=_mean(values),
        deviation=statistics.stdev(values) if len(values) > 1 else math.nan,
        count=len(values),
        left_out=len(gains) - len(values),
        improved=sum(quantity.verdict(gain) == "better" for gain in values),
        worst=_worst(finite, quantity),
    )


def worst_view(summaries: Sequence[Summary]) -> int | None:
    """Index of the view with the poorest gain in the first deciding metric; None where none was measured."""
    by_key = {summary.quantity.key: summary for summary in summaries}
    for key in DECIDING:
        if key in by_key and by_key[key].worst is not None:
            return by_key[key].worst
    return None


def _mean(values: Sequence[float]) -> float:
    return statistics.fmean(values) if values else math.nan


def _worst(gains: dict[int, float], quantity: Quantity) -> int | None:
    if not gains or quantity.higher_is_better is None:
        return None
    sign = 1 if quantity.higher_is_better else -1
    return min(gains, key=lambda i: sign * gains[i])
