"""The values of one metric behind one cell of a table: by scene-splat pair, seed and view, with missing values."""

import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field

SceneSplat = tuple[str, str]
"""Scene and splat as records name them, for instance ("fox", "3dgs/sparse")."""

Unit = tuple[SceneSplat, int | None]
"""Scene-splat pair and training seed; the seed is None for a method without training."""


@dataclass(frozen=True)
class ScoreSample:
    """Values of one method, or its gains over another method, in the metric's own unit and sign.

    The views of a unit have equal weights, then the seeds of a pair, then the pairs. Missing values stay in the sample
    with their reasons, so that every sample size can be printed with what is missing.

    Args:
        pairs: scene-splat pairs that the study covers.
        seeds: seeds that the study covers.
        values: finite values by unit and view; units without any are left out.
        missing: reason by unit, for units without values.
        unknown: reason by unit and view, for single views without a value in units that have values.
    """

    pairs: tuple[SceneSplat, ...]
    seeds: tuple[int | None, ...]
    values: Mapping[Unit, Mapping[str, float]]
    missing: Mapping[Unit, str] = field(default_factory=dict)
    unknown: Mapping[Unit, Mapping[str, str]] = field(default_factory=dict)

    @property
    def complete(self) -> bool:
        """Whether there are values and none is missing."""
        return bool(self.values) and not self.missing and not self.unknown

    @property
    def frames(self) -> int:
        """Number of values."""
        return sum(map(len, self.values.values()))

    def unit_means(self) -> dict[Unit, float]:
        """Mean over views, by pair and seed that have values, in the study's order."""
        order = [(pair, seed) for pair in self.pairs for seed in self.seeds if (pair, seed) in self.values]
        return {unit: statistics.fmean(self.values[unit].values()) for unit in order}

    def pair_means(self) -> dict[SceneSplat, float]:
        """Mean over seeds of the mean over views, by pair that has values."""
        means_by_pair: dict[SceneSplat, list[float]] = {}
        for (pair, _), mean in self.unit_means().items():
            means_by_pair.setdefault(pair, []).append(mean)
        return {pair: statistics.fmean(means) for pair, means in means_by_pair.items()}

    def mean(self) -> float:
        """Mean over pairs of the mean over seeds of the mean over views; NaN without values."""
        means = self.pair_means()
        return statistics.fmean(means.values()) if means else math.nan

    def view_means(self) -> dict[SceneSplat, dict[str, float]]:
        """Mean over seeds, by pair and view; views are sorted by name."""
        values_by_view: dict[SceneSplat, dict[str, list[float]]] = {}
        for (pair, _), views in self.values.items():
            for view, value in views.items():
                values_by_view.setdefault(pair, {}).setdefault(view, []).append(value)
        return {
            pair: {view: statistics.fmean(values_by_view[pair][view]) for view in sorted(values_by_view[pair])}
            for pair in self.pairs
            if pair in values_by_view
        }

    def counts(self) -> tuple[int, int, int]:
        """Numbers of scenes, seeds and views with values; a view is counted once, however many seeds have it."""
        views = {(pair, view) for (pair, _), members in self.values.items() for view in members}
        return len({pair[0] for pair, _ in self.values}), len({seed for _, seed in self.values}), len(views)

    def missing_pairs(self) -> int:
        """Number of pairs without any value."""
        return len({pair for pair, _ in self.missing} - {pair for pair, _ in self.values})
