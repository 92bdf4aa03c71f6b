"""Statistics of a table's cells: repeated runs, intervals over scenes and seeds, tests with Holm's correction.

All start from a `ScoreSample`. Which direction of a metric is better is data: `metrics.records.HIGHER_IS_BETTER`.
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
"""Sign patterns of a test: all of them up to 14 units, a draw of so many beyond."""

FEWEST = 6
"""Units that a test or an interval needs. The least p-value of a sign-flip test of 5 units is 2 / 32."""

DRAWS = 4999
"""Resamples of a bootstrap."""


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


def over_seeds(gains: ScoreSample) -> Spread:
    """Spread over trainings: a run is one seed's whole experiment, its gain the mean over scenes of that over views.

    This is how the paper's tables 7-9 are read here: its tables 2 and 4-6 are said to be the first of the runs, and
    are means over a dataset. Runs are averaged over the same scenes, those that every run with any number has, so that
    the spread is not one of scenes; the others are left out by name.
    """
    units = gains.unit_means()
    ran = [seed for seed in gains.seeds if any((pair, seed) in units for pair in gains.pairs)]
    common = [pair for pair in gains.pairs if ran and all((pair, seed) in units for seed in ran)]
    left_out = {_run(seed): _reason(gains, ((p, seed) for p in gains.pairs)) for seed in gains.seeds if seed not in ran}
    for pair in gains.pairs:
        if pair not in common and ran:
            lacking = ((pair, seed) for seed in ran if (pair, seed) not in units)
            left_out[f"scene {pair[0]}"] = _reason(gains, lacking)
    runs = {_run(seed): statistics.fmean(units[pair, seed] for pair in common) for seed in ran if common}
    return _spread(runs, left_out)


def over_scenes_and_seeds(gains: ScoreSample) -> Spread:
    """Spread over scenes and trainings: a run is one seed on one scene, its gain the mean over views.

    Wider than `over_seeds`, as scenes differ: it says how much the gain on a single scene may be off the mean.
    """
    runs = {f"{pair[0]}, {_run(seed)}": mean for (pair, seed), mean in gains.unit_means().items()}
    return _spread(runs, {f"{pair[0]}, {_run(seed)}": reason for (pair, seed), reason in gains.missing.items()})


def interval(sample: ScoreSample, level: float = 0.95) -> tuple[float, float]:
    """Bootstrap interval of the sample's mean: BCa, `scipy.stats.bootstrap`.

    What is drawn are scenes, each with all its splats, seeds and views, where there are at least `FEWEST` of them.
    Where there are fewer, the scenes are fixed and each scene's views are drawn, each with all its splats and seeds:
    numbers that share a photo stay together, and the interval speaks of these scenes and these trainings alone.

    A bootstrap of n units is too narrow by sqrt((n - 1) / n) and takes no account of the heavy tails of a small
    sample. The level is therefore raised so that each tail is Phi(sqrt(n / (n - 1)) t_tail(degrees of freedom)), as
    Hesterberg recommends. Below `FEWEST` units this would ask for the extremes of the draws, so there is no interval.

    Sources: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapter 14 (BCa); Hesterberg, What Teachers
    Should Know About the Bootstrap, The American Statistician 69, 2015 (expanded percentiles).

    Args:
        sample: numbers of a table's cell.
        level: share of intervals that shall hold the true mean.

    Returns:
        Lower and upper end; NaN where there are too few units.
    """
    scenes = _scene_matrices(sample)
    if len(scenes) >= FEWEST:
        totals = np.array([[np.nanmean(values, axis=1).sum(), len(values)] for values in scenes])
        return _bca([np.arange(len(scenes))], lambda drawn: totals[drawn[0]], level)
    if not scenes or any(values.shape[1] < 2 for values in scenes):
        return math.nan, math.nan
    if sum(values.shape[1] - 1 for values in scenes) < FEWEST - 1:
        return math.nan, math.nan

    def means(drawn: Sequence[ndarray]) -> ndarray:
        with np.errstate(invalid="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a draw may hold no view of one of the splats
            by_pair = [np.nanmean(v[:, i], axis=-1) for v, i in zip(scenes, drawn, strict=True)]
        stacked = np.concatenate(by_pair)
        return np.stack([np.nansum(stacked, axis=0), np.isfinite(stacked).sum(axis=0)], axis=-1)[..., None, :]

    return _bca([np.arange(values.shape[1]) for values in scenes], means, level)


def _bca(units: list[ndarray], totals: Callable[[Sequence[ndarray]], ndarray], level: float) -> tuple[float, float]:
    """BCa interval of sum over units / their weights; ``totals`` gives (..., drawn unit, sum and weight)."""

    def mean(*drawn: ndarray, axis: int = -1) -> ndarray | np.floating:
        found = totals([np.moveaxis(one, axis, -1).astype(int) for one in drawn]).sum(axis=-2)
        return found[..., 0] / found[..., 1]

    counts = [len(one) for one in units]
    size, freedom = len(counts) / sum(1 / count for count in counts), sum(counts) - len(counts)
    tail = stats.norm.cdf(math.sqrt(size / (size - 1)) * stats.t.ppf((1 - level) / 2, freedom))
    value, options = float(mean(*units)), {"n_resamples": DRAWS, "confidence_level": 1 - 2 * float(tail), "axis": -1}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        found = stats.bootstrap(units, mean, method="BCa", rng=np.random.default_rng(0), **options)
    low, high = float(found.confidence_interval.low), float(found.confidence_interval.high)
    if math.isnan(low) or math.isnan(high):  # every draw has the same mean, or the correction has no value
        found = stats.bootstrap(units, mean, method="percentile", rng=np.random.default_rng(0), **options)
        low, high = float(found.confidence_interval.low), float(found.confidence_interval.high)
    return (value, value) if math.isnan(low) else (low, high)


def _scene_matrices(sample: ScoreSample) -> list[Float[ndarray, "splat view"]]:
    """Means over seeds by scene: one line a splat, one column a view, NaN where a splat lacks the view."""
    scenes: dict[str, list[dict[str, float]]] = {}
    for (scene, _), views in sample.view_means().items():
        scenes.setdefault(scene, []).append(views)
    return [pd.DataFrame(splats).sort_index(axis=1).to_numpy(dtype=float) for splats in scenes.values()]


def units_of(gains: ScoreSample) -> tuple[str, tuple[float, ...]]:
    """The means that a test of these gains is made on, and what one of them stands for.

    One mean a scene and seed. Where these are fewer than `FEWEST`, so that no outcome could be told from chance, one a
    view, over its seeds: neighbouring views see the same things, and the test speaks of these trainings alone.

    Returns:
        "scene and seed" or "view", and the means in an order of their own.
    """
    units = gains.unit_means()
    if len(units) >= FEWEST:
        return "scene and seed", tuple(units.values())
    return "view", tuple(mean for views in gains.view_means().values() for mean in views.values())


def sign_flip(differences: Iterable[float]) -> float:
    """Two-sided p-value of paired differences: how often chance signs bring the mean as far from zero.

    For paired means of a method minus another (`units_of`). If the two methods were alike, each
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


def _spread(runs: Mapping[str, float], left_out: Mapping[str, str]) -> Spread:
    gains: Sequence[float] = list(runs.values())
    if not gains:
        return Spread(math.nan, math.nan, math.nan, math.nan, {}, left_out)
    deviation = statistics.stdev(gains) if len(gains) > 1 else math.nan
    return Spread(max(gains), min(gains), statistics.fmean(gains), deviation, runs, left_out)


def _run(seed: int | None) -> str:
    return "no seed" if seed is None else f"seed {seed}"


def _reason(gains: ScoreSample, units: Iterable[Unit]) -> str:
    """Every reason of these units, each once."""
    return "; ".join(dict.fromkeys(gains.missing.get(unit, "no record") for unit in units))
