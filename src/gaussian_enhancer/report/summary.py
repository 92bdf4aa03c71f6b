"""Summary of a metric over all views: mean gain, spread and worst view."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from gaussian_enhancer.metrics.comparison import Comparison, VariantPair, compare
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.report.compared import ComparedView
from gaussian_enhancer.report.quantities import RANKING_METRICS, Quantity, quantities


@dataclass(frozen=True)
class MetricSummary:
    """Summary of one metric over all views that have it.

    Args:
        quantity: the metric.
        comparison: means, spread and worst view, as in the tables.
        improved: number of views whose gain is an improvement after rounding.
        infinite: number of views left out because the gain is not finite, as with identical images.
        worst: index of the view with the worst gain; None if the metric has no direction or no view has a gain.
    """

    quantity: Quantity
    comparison: Comparison
    improved: int
    infinite: int
    worst: int | None


def gain_of(view: ComparedView, key: str) -> float | None:
    """Enhanced minus raw value in the metric's unit; None if one of them was not measured."""
    return _pair(view).gain(key)


def measured_quantities(views: Sequence[ComparedView]) -> tuple[Quantity, ...]:
    """The metrics that at least one view has, or gives a reason for not having."""
    keys: set[str] = set()
    for view in views:
        keys |= {*view.metrics_raw, *view.metrics_enhanced, *view.reasons}
    return quantities(keys)


def summarise(views: Sequence[ComparedView], quantity: Quantity) -> MetricSummary:
    """Mean, spread and worst view of one metric."""
    comparison = compare([_pair(view) for view in views], quantity.key)
    gains = [gain for view in views if (gain := gain_of(view, quantity.key)) is not None]
    names = [view.name for view in views]
    return MetricSummary(
        quantity=quantity,
        comparison=comparison,
        improved=sum(math.isfinite(gain) and quantity.verdict(gain) == "better" for gain in gains),
        infinite=sum(not math.isfinite(gain) for gain in gains),
        worst=names.index(comparison.worst) if comparison.worst in names else None,
    )


def worst_view(summaries: Sequence[MetricSummary]) -> int | None:
    """Index of the view with the worst gain in the first metric of `RANKING_METRICS` that has one, or None."""
    by_key = {summary.quantity.key: summary for summary in summaries}
    worst_indices = (by_key[key].worst for key in RANKING_METRICS if key in by_key)
    return next((worst for worst in worst_indices if worst is not None), None)


def _pair(view: ComparedView) -> VariantPair:
    """The view as a pair of records, the input of the statistics of tables."""
    raw, enhanced = (
        Record("quality", "", "", "", view.name, variant, dict(metrics), commit="-", machine="-", time="-")
        for variant, metrics in (("raw", view.metrics_raw), ("enhanced", view.metrics_enhanced))
    )
    return VariantPair(raw, enhanced)
