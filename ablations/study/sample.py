"""The numbers of one metric behind one cell of a table: by scene-splat pair, seed and view, with what is missing."""

import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field

SceneSplat = tuple[str, str]
"""Scene and splat as records name them, for instance ("fox", "3dgs/sparse")."""

Unit = tuple[SceneSplat, int | None]
"""Scene-splat pair and training seed; the seed is None where nothing was trained."""


@dataclass(frozen=True)
class ScoreSample:
    """Numbers of one method, or gains of a method over another, in the metric's own unit and sign.

    The views of a pair have equal weights, then the seeds of a pair, then the pairs. What is missing stays in the
    sample with its reason, so that every n can be printed beside what it lacks.

    Args:
        pairs: scene-splat pairs that the study asks for.
        seeds: those that the study asks for.
        values: finite numbers by unit and view; a unit without any is not among them.
        missing: why a unit has no number.
        unknown: why single views of a unit that has numbers have none.
    """

    pairs: tuple[SceneSplat, ...]
    seeds: tuple[int | None, ...]
    values: Mapping[Unit, Mapping[str, float]]
    missing: Mapping[Unit, str] = field(default_factory=dict)
    unknown: Mapping[Unit, Mapping[str, str]] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        """Whether there are numbers and none is missing."""
        return bool(self.values) and not self.missing and not self.unknown

    @property
    def frames(self) -> int:
        """How many numbers there are."""
        return sum(map(len, self.values.values()))

    def unit_means(self) -> dict[Unit, float]:
        """Mean over the views of every pair and seed that has any, in the study's order."""
        order = [(pair, seed) for pair in self.pairs for seed in self.seeds if (pair, seed) in self.values]
        return {unit: statistics.fmean(self.values[unit].values()) for unit in order}

    def pair_means(self) -> dict[SceneSplat, float]:
        """Mean over the seeds of the mean over views, by pair that has any."""
        found: dict[SceneSplat, list[float]] = {}
        for (pair, _), mean in self.unit_means().items():
            found.setdefault(pair, []).append(mean)
        return {pair: statistics.fmean(means) for pair, means in found.items()}

    def mean(self) -> float:
        """Mean over pairs of the mean over seeds of the mean over views; NaN without any."""
        means = self.pair_means()
        return statistics.fmean(means.values()) if means else math.nan

    def view_means(self) -> dict[SceneSplat, dict[str, float]]:
        """Mean over seeds by pair and view, views by name."""
        found: dict[SceneSplat, dict[str, list[float]]] = {}
        for (pair, _), views in self.values.items():
            for view, value in views.items():
                found.setdefault(pair, {}).setdefault(view, []).append(value)
        return {
            pair: {view: statistics.fmean(found[pair][view]) for view in sorted(found[pair])}
            for pair in self.pairs
            if pair in found
        }

    def counts(self) -> tuple[int, int, int]:
        """How many scenes, seeds and views have numbers; a view is counted once, however many seeds see it."""
        views = {(pair, view) for (pair, _), members in self.values.items() for view in members}
        return len({pair[0] for pair, _ in self.values}), len({seed for _, seed in self.values}), len(views)

    def missing_pairs(self) -> int:
        """How many pairs have no number at all."""
        return len({pair for pair, _ in self.missing} - {pair for pair, _ in self.values})
