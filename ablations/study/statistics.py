"""Statistics of a table's cells: repeated runs, intervals over scenes and seeds, tests with Holm's correction.

All are computed from a `ScoreSample`. `metrics.records.HIGHER_IS_BETTER` states the better direction of a metric.
"""

import math
import statistics
import warnings
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray
from scipy import stats

from ablations.study.sample import ScoreSample, Unit

Key = TypeVar("Key", bound=Hashable)

FLIPS = 2**14
"""Sign patterns of a test: all of them for up to 14 units, a random sample of this size for more."""

MIN_UNITS = 6
"""Least number of units of a test or an interval. The smallest p-value of a sign-flip test of 5 units is 2 / 32."""

DRAWS = 4999
"""Resamples of a bootstrap."""

LEVEL = 0.95
"""Share of intervals that shall contain the true mean."""


@dataclass(frozen=True)
class Spread:
    """Statistics of repeated runs, as in the paper's tables 7-9.

    Maximum and minimum are numerical; they do not depend on which direction of the metric is better. Without runs, all
    statistics are NaN.

    Args:
        maximum: largest gain of a run.
        minimum: smallest gain of a run.
        mean: mean over runs.
        deviation: standard deviation over runs (ddof=1); NaN below two runs.
        runs: the gain of every run, by its name.
        left_out: reason by name of each excluded run or scene.
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


def spread_over_seeds(gains: ScoreSample) -> Spread:
    """Spread over trainings: a run is the experiment with one seed, its gain the mean over scenes of means over views.

    This is our reading of the paper's tables 7-9: its tables 2 and 4-6 are said to be the first of the runs, and are
    means over a dataset. All runs are averaged over the same scenes, so that scenes add nothing to the spread. These
    are the scenes that every run with any value has; the other scenes are excluded by name.
    """
    units = gains.unit_means()
    available_seeds = [seed for seed in gains.seeds if any((pair, seed) in units for pair in gains.pairs)]
    common = [
        pair for pair in gains.pairs if available_seeds and all((pair, seed) in units for seed in available_seeds)
    ]
    left_out = {
        _run(seed): _reason(gains, ((p, seed) for p in gains.pairs))
        for seed in gains.seeds
        if seed not in available_seeds
    }
    for pair in gains.pairs:
        if pair not in common and available_seeds:
            missing_units = ((pair, seed) for seed in available_seeds if (pair, seed) not in units)
            left_out[f"scene {pair[0]}"] = _reason(gains, missing_units)
    runs = {_run(seed): statistics.fmean(units[pair, seed] for pair in common) for seed in available_seeds if common}
    return _spread(runs, left_out)


def spread_over_scenes_and_seeds(gains: ScoreSample) -> Spread:
    """Spread over scenes and trainings: a run is one seed on one scene; its gain is the mean over views.

    It is wider than that of `spread_over_seeds`, since scenes differ: it shows how far the gain on one scene may be
    from the mean.
    """
    runs = {f"{pair[0]}, {_run(seed)}": mean for (pair, seed), mean in gains.unit_means().items()}
    return _spread(runs, {f"{pair[0]}, {_run(seed)}": reason for (pair, seed), reason in gains.missing.items()})


def interval(sample: ScoreSample) -> tuple[float, float]:
    """95% bootstrap interval of the sample's mean: BCa, `scipy.stats.bootstrap`.

    With at least `MIN_UNITS` scenes, scenes are resampled, each with all its splats, seeds and views. With fewer, the
    scenes are fixed and the views of each scene are resampled, each with all its splats and seeds: values that share a
    photo stay together, and the interval holds for these scenes and these trainings only.

    Below `MIN_UNITS` units `expanded_bca` would require the extremes of the resamples, so no interval is given.

    Args:
        sample: values of a table's cell.

    Returns:
        Lower and upper end; NaN for too few units.
    """
    scenes = _scene_matrices(sample)
    if len(scenes) >= MIN_UNITS:
        totals = np.array([[np.nanmean(values, axis=1).sum(), len(values)] for values in scenes])
        return expanded_bca([np.arange(len(scenes))], lambda drawn: totals[drawn[0]])
    if not scenes or any(values.shape[1] < 2 for values in scenes):
        return math.nan, math.nan
    if sum(values.shape[1] - 1 for values in scenes) < MIN_UNITS - 1:
        return math.nan, math.nan

    def means(drawn: Sequence[ndarray]) -> ndarray:
        with np.errstate(invalid="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a resample may have no view of one of the splats
            by_pair = [np.nanmean(v[:, i], axis=-1) for v, i in zip(scenes, drawn, strict=True)]
        stacked = np.concatenate(by_pair)
        return np.stack([np.nansum(stacked, axis=0), np.isfinite(stacked).sum(axis=0)], axis=-1)[..., None, :]

    return expanded_bca([np.arange(values.shape[1]) for values in scenes], means)


def expanded_bca(units: list[ndarray], totals: Callable[[Sequence[ndarray]], ndarray]) -> tuple[float, float]:
    """95% BCa bootstrap interval of a weighted mean over units, corrected for small samples.

    A bootstrap interval of n units is too narrow by sqrt((n - 1) / n) and does not account for the heavy tails of a
    small sample. The level is therefore raised so that each tail is Phi(sqrt(n / (n - 1)) t_tail(degrees of freedom)),
    as Hesterberg recommends.

    Sources: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapter 14 (BCa); Hesterberg, What Teachers
    Should Know About the Bootstrap, The American Statistician 69, 2015 (expanded percentiles).

    Args:
        units: one array of indices per stratum, each with at least two units.
        totals: returns (..., drawn unit, [sum, weight]) for the drawn indices of every stratum.

    Returns:
        Lower and upper end; the mean itself if all resamples have the same mean.
    """

    def mean(*drawn: ndarray, axis: int = -1) -> ndarray | np.floating:
        result = totals([np.moveaxis(indices, axis, -1).astype(int) for indices in drawn]).sum(axis=-2)
        return result[..., 0] / result[..., 1]

    counts = [len(indices) for indices in units]
    size, freedom = len(counts) / sum(1 / count for count in counts), sum(counts) - len(counts)
    tail = stats.norm.cdf(math.sqrt(size / (size - 1)) * stats.t.ppf((1 - LEVEL) / 2, freedom))
    value, options = float(mean(*units)), {"n_resamples": DRAWS, "confidence_level": 1 - 2 * float(tail), "axis": -1}
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):  # of two units, the level is 1
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        result = stats.bootstrap(units, mean, method="BCa", rng=np.random.default_rng(0), **options)
    low, high = float(result.confidence_interval.low), float(result.confidence_interval.high)
    if math.isnan(low) or math.isnan(high):  # all resamples have the same mean, or the BCa correction is undefined
        result = stats.bootstrap(units, mean, method="percentile", rng=np.random.default_rng(0), **options)
        low, high = float(result.confidence_interval.low), float(result.confidence_interval.high)
    return (value, value) if math.isnan(low) else (low, high)


def _scene_matrices(sample: ScoreSample) -> list[Float[ndarray, "splat view"]]:
    """Means over seeds, one matrix per scene: one row per splat, one column per view, NaN for a missing view."""
    scenes: dict[str, list[dict[str, float]]] = {}
    for (scene, _), views in sample.view_means().items():
        scenes.setdefault(scene, []).append(views)
    return [pd.DataFrame(splats).sort_index(axis=1).to_numpy(dtype=float) for splats in scenes.values()]


def units_of(gains: ScoreSample) -> tuple[str, tuple[float, ...]]:
    """The means that a test of gains uses, and what one mean is taken for.

    There is one mean per scene and seed. If these are fewer than `MIN_UNITS`, no outcome could be significant; there
    is then one mean per view, over its seeds. Neighbouring views show the same surfaces, and the test holds for these
    trainings only.

    Returns:
        "scene and seed" or "view", and the means in arbitrary order.
    """
    units = gains.unit_means()
    if len(units) >= MIN_UNITS:
        return "scene and seed", tuple(units.values())
    return "view", tuple(mean for views in gains.view_means().values() for mean in views.values())


def sign_flip(differences: Iterable[float]) -> float:
    """Two-sided p-value of paired differences: how often random signs bring the mean as far from zero.

    For paired means of a method minus another (`units_of`). If the two methods were equal, each difference could as
    well have the other sign. For up to 14 units, all 2^n sign patterns are tried, so that the p-value is exact and
    never below 2 / 2^n; for more units, `FLIPS` patterns are drawn. Unlike the signed-rank test, it tests the mean that
    the table prints. Seeds of one scene share its photos and renders: the test holds for these scenes, not for all.
    Source: Fisher, The Design of Experiments, 1935, section 21.

    Args:
        differences: one finite value per unit.

    Returns:
        p-value; NaN below two units, where no result could be significant.
    """
    values = sorted(differences)
    if len(values) < 2:
        return math.nan
    if not any(values):
        return 1.0
    rng = np.random.default_rng(0)
    test = stats.permutation_test((values,), np.mean, permutation_type="samples", n_resamples=FLIPS, random_state=rng)
    return float(test.pvalue)


def holm(values: Mapping[Key, float]) -> dict[Key, float]:
    """Holm's step-down correction: the k-th smallest of m p-values times m - k + 1, made non-decreasing, at most 1.

    It keeps the family-wise error rate below the level, whatever the dependence of the tests. NaN means no test: it
    stays NaN and is not counted in m. Source: S. Holm, Scandinavian Journal of Statistics 6, 1979.
    """
    sorted_values = sorted((value, position) for position, value in enumerate(values.values()) if not math.isnan(value))
    corrected, highest = [math.nan] * len(values), 0.0
    for rank, (value, position) in enumerate(sorted_values):
        highest = max(highest, min(1.0, value * (len(sorted_values) - rank)))
        corrected[position] = highest
    return dict(zip(values, corrected, strict=True))


def _spread(runs: Mapping[str, float], left_out: Mapping[str, str]) -> Spread:
    gains: Sequence[float] = list(runs.values())
    if not gains:
        return Spread(math.nan, math.nan, math.nan, math.nan, {}, left_out)
    deviation = statistics.stdev(gains) if len(gains) > 1 else math.nan
    return Spread(max(gains), min(gains), statistics.fmean(gains), deviation, runs, left_out)


def _run(seed: int | None) -> str:
    return "no seed" if seed is None else f"seed {seed}"


def _reason(gains: ScoreSample, units: Iterable[Unit]) -> str:
    """The distinct reasons of missing units, as one text."""
    return "; ".join(dict.fromkeys(gains.missing.get(unit, "no record") for unit in units))
