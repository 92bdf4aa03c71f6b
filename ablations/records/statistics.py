"""Statistics of a table's cells: repeated runs, intervals over scenes and seeds, tests with Holm's correction.

All start from a `Sample`: numbers by scene, seed and view. A scene's views count alike, then a scene's seeds, then the
scenes. What is missing stays in the sample with its reason, so that every n can be printed beside what it lacks.
Which direction of a metric is better is data: `measure.records.HIGHER_IS_BETTER`.
"""

import math
import statistics
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy import stats

Unit = tuple[str, int | None]
"""Scene and training seed; the seed is None where nothing was trained."""

Key = TypeVar("Key", bound=Hashable)

FLIPS = 2**14
"""Sign patterns of a test: all of them up to 14 units, a draw of so many beyond."""

FEWEST = 6
"""Units that a test needs to fall below 0.05: with 5 its least p-value is 2 / 32."""


@dataclass(frozen=True)
class Sample:
    """Numbers of one row, or gains of a row over another, in the metric's own unit and sign.

    Args:
        scenes: those that the table asks for.
        seeds: those that the table asks for.
        values: finite numbers by unit and view; a unit without any is not among them.
        missing: why a unit has no number.
        unknown: why single views of a unit that has numbers have none.
    """

    scenes: tuple[str, ...]
    seeds: tuple[int | None, ...]
    values: Mapping[Unit, Mapping[str, float]]
    missing: Mapping[Unit, str] = field(default_factory=dict)
    unknown: Mapping[Unit, Mapping[str, str]] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        """Whether there are numbers and none is missing."""
        return bool(self.values) and not self.missing and not self.unknown

    def unit_means(self) -> dict[Unit, float]:
        """Mean over the views of every scene and seed that has any, in the table's order."""
        order = [(scene, seed) for scene in self.scenes for seed in self.seeds if (scene, seed) in self.values]
        return {unit: statistics.fmean(self.values[unit].values()) for unit in order}

    def scene_means(self) -> dict[str, float]:
        """Mean over the seeds of the mean over views, by scene that has any."""
        return {scene: statistics.fmean(seeds) for scene, seeds in _by_scene(self.unit_means()).items()}

    def mean(self) -> float:
        """Mean over scenes of the mean over seeds of the mean over views; NaN without any."""
        means = self.scene_means()
        return statistics.fmean(means.values()) if means else math.nan

    def counts(self) -> tuple[int, int, int]:
        """How many scenes, seeds and views have numbers; a view is counted once, however many seeds see it."""
        views = {(scene, view) for (scene, _), members in self.values.items() for view in members}
        return len({scene for scene, _ in self.values}), len({seed for _, seed in self.values}), len(views)


@dataclass(frozen=True)
class Spread:
    """Statistics of repeated runs, as in the paper's tables 7-9, whose largest and smallest are numbers, not merits.

    Args:
        maximum: largest gain of a run; NaN without runs, as all of them.
        minimum: smallest.
        mean: mean over runs.
        deviation: standard deviation over runs (ddof=1); NaN below two runs.
        runs: the gain of every run, by its name.
        left_out: what does not count, with the reason.
    """

    maximum: float
    minimum: float
    mean: float
    deviation: float
    runs: Mapping[str, float]
    left_out: Mapping[str, str]

    @property
    def count(self) -> int:
        """Number of runs."""
        return len(self.runs)


def over_seeds(gains: Sample) -> Spread:
    """Spread over trainings: a run is one seed's whole experiment, its gain the mean over scenes of that over views.

    This is how the paper's tables 7-9 are read here: its tables 2 and 4-6 are said to be the first of the runs, and
    are means over a dataset. Runs are averaged over the same scenes, those that every run with any number has, so that
    the spread is not one of scenes; the others are left out by name.
    """
    units = gains.unit_means()
    ran = [seed for seed in gains.seeds if any((scene, seed) in units for scene in gains.scenes)]
    common = [scene for scene in gains.scenes if ran and all((scene, seed) in units for seed in ran)]
    left_out = {
        _run(seed): _reason(gains, ((s, seed) for s in gains.scenes)) for seed in gains.seeds if seed not in ran
    }
    for scene in gains.scenes:
        if scene not in common and ran:
            lacking = ((scene, seed) for seed in ran if (scene, seed) not in units)
            left_out[f"scene {scene}"] = _reason(gains, lacking)
    runs = {_run(seed): statistics.fmean(units[scene, seed] for scene in common) for seed in ran if common}
    return _spread(runs, left_out)


def over_scenes_and_seeds(gains: Sample) -> Spread:
    """Spread over scenes and trainings: a run is one seed on one scene, its gain the mean over views.

    Wider than `over_seeds`, as scenes differ: it says how much the gain on a single scene may be off the mean.
    """
    runs = {f"{scene}, {_run(seed)}": mean for (scene, seed), mean in gains.unit_means().items()}
    return _spread(runs, {f"{scene}, {_run(seed)}": reason for (scene, seed), reason in gains.missing.items()})


def bootstrap_interval(sample: Sample, resamples: int = 2000, level: float = 0.95) -> tuple[float, float]:
    """Bootstrap interval of the sample's mean that draws scenes, seeds and views anew, with replacement.

    One training serves all scenes, and one view is seen by all seeds. Seeds are therefore drawn once a resample, and
    views once a drawn scene: numbers that share a seed or a view stay together. The percentiles are widened for few
    scenes: tail = Phi(sqrt(n / (n - 1)) t_tail(n - 1)) with n scenes (seeds where there is one scene, views where
    there is one of each), since plain percentiles are too narrow by that factor. Source: Hesterberg, What Teachers
    Should Know About the Bootstrap, The American Statistician 69, 2015 (expanded percentile intervals). With fewer
    than about five scenes the interval reaches to the extremes of the resampled means. One scene's interval knows
    nothing of other scenes.

    Args:
        sample: numbers of a cell.
        resamples: number of bootstrap samples.
        level: share of intervals that shall hold the true mean.

    Returns:
        Lower and upper end; NaN without numbers, and the number itself twice where there is one only.
    """
    values = _array(sample)
    if not values.size:
        return math.nan, math.nan
    generator = np.random.default_rng(0)
    batch = max(1, min(resamples, 4_000_000 // values.size))
    sizes = [min(batch, resamples - start) for start in range(0, resamples, batch)]
    means = np.concatenate([_resampled(values, size, generator) for size in sizes])
    views = int((~np.isnan(values)).any(axis=1).sum())
    count = next((n for n in (values.shape[0], values.shape[1], views) if n > 1), 1)
    tail = (1 - level) / 2
    if count > 1:
        tail = float(stats.norm.cdf(math.sqrt(count / (count - 1)) * stats.t.ppf(tail, count - 1)))
    low, high = np.nanquantile(means, [tail, 1 - tail])
    return float(low), float(high)


def units_of(gains: Sample) -> tuple[str, tuple[float, ...]]:
    """The means that a test of these gains is made on, and what one of them stands for.

    One mean a scene and seed. Where these are fewer than `FEWEST`, so that no outcome could be told from chance, one a
    view, over its seeds: neighbouring views see the same things, and the test speaks of these trainings alone.

    Returns:
        "scene and seed" or "view", and the means in an order of their own.
    """
    units = gains.unit_means()
    if len(units) >= FEWEST:
        return "scene and seed", tuple(units.values())
    views: dict[tuple[str, str], list[float]] = {}
    for (scene, _), found in gains.values.items():
        for view, value in found.items():
            views.setdefault((scene, view), []).append(value)
    return "view", tuple(statistics.fmean(views[key]) for key in sorted(views))


def sign_flip(differences: Iterable[float]) -> float:
    """Two-sided p-value of paired differences: how often chance signs bring the mean as far from zero.

    For paired means of a row minus another (`units_of`). If the two rows were alike, each
    difference could as well have the other sign. All 2^n patterns are tried for up to 14 units, so that the p-value is
    exact and never below 2 / 2^n; beyond, as many are drawn. Unlike the signed-rank test it asks about the mean that
    the table prints. Seeds of one scene share its photos and renders: the test speaks of these scenes, not of all.
    Source: Fisher, The Design of Experiments, 1935, section 21.

    Args:
        differences: one a unit, finite.

    Returns:
        p-value; NaN below two units, of which none could tell.
    """
    values = sorted(differences)
    if len(values) < 2:
        return math.nan
    if not any(values):
        return 1.0
    chance = np.random.default_rng(0)
    found = stats.permutation_test(
        (values,), np.mean, permutation_type="samples", n_resamples=FLIPS, random_state=chance
    )
    return float(found.pvalue)


def holm(values: Mapping[Key, float]) -> dict[Key, float]:
    """Holm's step-down correction: the k-th smallest of m p-values times m - k + 1, never falling, at most 1.

    Keeps the chance of even one false finding among all tests below the level, whatever their dependence. A NaN, no
    test, stays NaN and is not counted in m. Source: S. Holm, Scandinavian Journal of Statistics 6, 1979.
    """
    known = sorted((value, position) for position, value in enumerate(values.values()) if not math.isnan(value))
    corrected, highest = [math.nan] * len(values), 0.0
    for rank, (value, position) in enumerate(known):
        highest = max(highest, min(1.0, value * (len(known) - rank)))
        corrected[position] = highest
    return dict(zip(values, corrected, strict=True))


def _array(sample: Sample) -> Float[ndarray, "scene seed view"]:
    """The numbers, NaN where there is none; a scene's views come first on the last axis."""
    scenes = [scene for scene in sample.scenes if any(unit[0] == scene for unit in sample.values)]
    seeds = [seed for seed in sample.seeds if any(unit[1] == seed for unit in sample.values)]
    views = {s: sorted({v for unit, found in sample.values.items() if unit[0] == s for v in found}) for s in scenes}
    values = np.full((len(scenes), len(seeds), max(map(len, views.values()), default=0)), math.nan)
    for i, scene in enumerate(scenes):
        for j, seed in enumerate(seeds):
            found = sample.values.get((scene, seed), {})
            values[i, j, : len(views[scene])] = [found.get(view, math.nan) for view in views[scene]]
    return values


def _resampled(
    values: Float[ndarray, "scene seed view"], count: int, generator: np.random.Generator
) -> Float[ndarray, " count"]:
    """Means of resamples; NaN for one that drew nothing but gaps."""
    scenes, seeds, views = values.shape
    filled = (~np.isnan(values)).any(axis=1).sum(axis=1)
    scene = generator.integers(scenes, size=(count, scenes, 1, 1))
    seed = generator.integers(seeds, size=(count, 1, seeds, 1))
    members = filled[scene]
    view = (generator.random((count, scenes, 1, views)) * members).astype(int)
    drawn = np.where(np.arange(views) < members, values[scene, seed, view], math.nan)
    return _mean(_mean(_mean(drawn)))


def _mean(values: Float[ndarray, "*rest last"]) -> Float[ndarray, "*rest"]:
    """Mean over the last axis of what is there; NaN where nothing is."""
    known = ~np.isnan(values)
    with np.errstate(invalid="ignore"):
        return np.where(known, values, 0.0).sum(axis=-1) / known.sum(axis=-1)


def _by_scene(units: Mapping[Unit, float]) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {}
    for (scene, _), mean in units.items():
        found.setdefault(scene, []).append(mean)
    return found


def _spread(runs: Mapping[str, float], left_out: Mapping[str, str]) -> Spread:
    gains: Sequence[float] = list(runs.values())
    if not gains:
        return Spread(math.nan, math.nan, math.nan, math.nan, {}, left_out)
    deviation = statistics.stdev(gains) if len(gains) > 1 else math.nan
    return Spread(max(gains), min(gains), statistics.fmean(gains), deviation, runs, left_out)


def _run(seed: int | None) -> str:
    return "no seed" if seed is None else f"seed {seed}"


def _reason(gains: Sample, units: Iterable[Unit]) -> str:
    """Every reason of these units, each once."""
    return "; ".join(dict.fromkeys(gains.missing.get(unit, "no record") for unit in units))
