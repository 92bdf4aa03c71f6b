"""Statistics against values worked out by hand, against scipy, and on numbers with a known truth."""

import math
import statistics
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from ablations.study.sample import ScoreSample
from ablations.study.statistics import (
    holm,
    interval,
    sign_flip,
    spread_over_scenes_and_seeds,
    spread_over_seeds,
    units_of,
)


def sample(values: dict[tuple[str, int | None], list[float]], missing: dict | None = None) -> ScoreSample:
    """One splat a scene; scenes and seeds in the order of their first mention."""
    units = [*values, *(missing or {})]
    pairs = tuple(dict.fromkeys((scene, "3dgs") for scene, _ in units))
    seeds = tuple(dict.fromkeys(seed for _, seed in units))
    views = {
        ((scene, "3dgs"), seed): {f"v{i}": value for i, value in enumerate(found)}
        for (scene, seed), found in values.items()
    }
    reasons = {((scene, "3dgs"), seed): reason for (scene, seed), reason in (missing or {}).items()}
    return ScoreSample(pairs, seeds, views, reasons)


GAINS = sample({("a", 0): [1.0, 3.0], ("a", 1): [2.0, 4.0], ("b", 0): [0.0], ("b", 1): [1.0]})
"""Means by scene and seed: a 2 and 3, b 0 and 1; by seed 1 and 2."""


def test_a_mean_counts_views_then_seeds_then_scenes_alike() -> None:
    uneven = sample({("a", 0): [1.0, 3.0], ("a", 1): [6.0], ("b", 0): [0.0]})
    assert [*uneven.unit_means().values()] == [2.0, 6.0, 0.0]
    assert uneven.mean() == 2.0  # a: (2 + 6) / 2; b: 0
    assert uneven.counts() == (2, 2, 3)
    assert math.isnan(sample({}).mean())


def test_repeated_runs_by_hand() -> None:
    by_seed = spread_over_seeds(GAINS)
    assert by_seed.runs == {"seed 0": 1.0, "seed 1": 2.0}
    assert (by_seed.maximum, by_seed.minimum, by_seed.mean, by_seed.count) == (2.0, 1.0, 1.5, 2)
    assert by_seed.deviation == pytest.approx(math.sqrt(0.5))  # ddof=1, where ddof=0 would give 0.5
    by_both = spread_over_scenes_and_seeds(GAINS)
    assert sorted(by_both.runs.values()) == [0.0, 1.0, 2.0, 3.0]
    assert by_both.deviation == pytest.approx(math.sqrt(5 / 3))


def test_the_largest_gain_is_the_largest_number_whatever_is_better() -> None:
    lpips = spread_over_seeds(sample({("a", 0): [-0.036], ("a", 1): [-0.026]}))
    assert (lpips.maximum, lpips.minimum) == (-0.026, -0.036)  # as the paper prints them


def test_one_run_has_no_deviation() -> None:
    one = spread_over_seeds(sample({("a", 0): [1.0]}))
    assert (one.count, one.mean, math.isnan(one.deviation)) == (1, 1.0, True)


def test_runs_are_averaged_over_the_same_scenes_and_name_what_they_leave_out() -> None:
    gaps = {("b", 1): "died of memory", ("a", 2): "not trained", ("b", 2): "not trained"}
    found = spread_over_seeds(sample({("a", 0): [1.0], ("a", 1): [2.0], ("b", 0): [100.0]}, gaps))
    assert found.runs == {"seed 0": 1.0, "seed 1": 2.0}
    assert found.left_out == {"seed 2": "not trained", "scene b": "died of memory"}
    nothing = spread_over_seeds(sample({}, gaps))
    assert nothing.count == 0
    assert math.isnan(nothing.mean)
    assert set(nothing.left_out) == {"seed 1", "seed 2"}


@pytest.mark.parametrize(
    "values", [{}, {("a", None): [2.5]}, {("a", None): [0.0, 1.0] * 2}, {("a", s): [1.0] for s in (0, 1)}]
)
def test_there_is_no_interval_of_too_few_numbers(values) -> None:
    assert all(map(math.isnan, interval(sample(values))))


def test_an_interval_of_equal_numbers_is_that_number() -> None:
    assert interval(sample({("a", None): [2.5] * 6})) == (2.5, 2.5)


def test_an_interval_does_not_depend_on_the_order_of_units_and_views() -> None:
    generator = np.random.default_rng(1)
    whole = sample({unit: generator.normal(size=4).tolist() for unit in product("abc", (0, 1))})
    turned = {unit: dict(reversed(list(views.items()))) for unit, views in reversed(list(whole.values.items()))}
    assert interval(ScoreSample(whole.pairs, whole.seeds, turned)) == interval(whole)


@pytest.mark.parametrize("by", ["scenes", "views"])
def test_an_interval_of_many_agrees_with_the_normal_one(by: str) -> None:
    values = np.random.default_rng(2).normal(3.0, 1.0, 60)
    scenes = {(f"s{i}", None): [value] for i, value in enumerate(values)}
    found = interval(sample(scenes if by == "scenes" else {("a", None): values.tolist()}))
    ends = stats.t.interval(0.95, 59, values.mean(), stats.sem(values))
    assert found == pytest.approx(ends, abs=0.05)


def test_an_interval_follows_the_skew_of_its_numbers() -> None:
    values = np.random.default_rng(5).exponential(1.0, 40)
    low, high = interval(sample({("a", None): values.tolist()}))
    assert high - values.mean() > 1.1 * (values.mean() - low)


def test_few_scenes_are_fixed_and_their_views_drawn() -> None:
    near = interval(sample({("a", None): [0.0, 1.0] * 4, ("b", None): [10.0, 11.0] * 4}))
    assert near[1] - near[0] < 1.0  # drawing the two scenes would give 0.5 to 10.5


def test_views_that_several_splats_share_are_drawn_together() -> None:
    views = {f"v{i}": value for i, value in enumerate(np.random.default_rng(6).normal(size=9))}
    pairs = tuple(("fox", splat) for splat in ("2dgs", "3dgs", "mip_splatting"))
    three = ScoreSample(pairs, (None,), {(pair, None): views for pair in pairs})
    one = ScoreSample(pairs[:1], (None,), {(pairs[0], None): views})
    assert interval(three) == pytest.approx(interval(one), abs=0.01)


def test_gaps_do_not_count_as_zeros() -> None:
    gappy = sample({("a", 0): [5.0] * 6, ("a", 1): [5.0], ("b", 1): [5.0, 5.0]})
    assert interval(gappy) == (5.0, 5.0)


SHAPES = {"scenes": (12, 6), "one scene": (1, 9), "few views": (1, 6), "four scenes": (4, 5)}
"""Scenes and views of the simulated studies."""


@pytest.mark.parametrize("draw", ["normal", "exponential"])
@pytest.mark.parametrize("shape", SHAPES)
def test_intervals_hold_the_truth_as_often_as_they_say(shape: str, draw: str) -> None:
    """Coverage by simulation; scenes differ in their means where scenes are drawn, else they are fixed."""
    generator, (scenes, views), held, trials = np.random.default_rng(3), SHAPES[shape], 0, 150
    own = generator.normal(0, 1, (trials, scenes, 1)) if shape == "scenes" else np.zeros((trials, scenes, 1))
    noise = generator.normal(size=(trials, scenes, views))
    if draw == "exponential":
        noise = generator.exponential(size=(trials, scenes, views)) - 1
    for values in 2.0 + own + 0.5 * noise:
        low, high = interval(sample({(f"s{i}", None): one.tolist() for i, one in enumerate(values)}))
        held += low <= 2.0 <= high
    assert (0.90 if draw == "normal" else 0.85) <= held / trials <= 0.99


def test_a_test_is_made_on_scenes_and_seeds_or_on_views_where_these_are_few() -> None:
    few = sample({("a", 0): [1.0, 3.0], ("a", 1): [2.0, 4.0]})
    assert units_of(few) == ("view", (1.5, 3.5))
    many = sample({(scene, seed): [float(seed)] for scene in "abc" for seed in (0, 1)})
    assert units_of(many) == ("scene and seed", (0.0, 1.0) * 3)


def test_sign_flips_by_hand() -> None:
    assert sign_flip([1.0, 2.0, 3.0]) == pytest.approx(2 / 8)  # only +++ and --- reach the mean of 2
    assert sign_flip([1.0, -2.0, 3.0]) == pytest.approx(6 / 8)  # all but the two patterns with mean 0
    assert sign_flip([0.0, 0.0]) == 1.0
    assert math.isnan(sign_flip([1.0]))


def test_sign_flips_agree_with_the_signed_rank_test_on_ranks() -> None:
    ranks = [1.0, -2.0, 3.0, 4.0, -5.0, 6.0, 7.0, 8.0]
    assert sign_flip(ranks) == pytest.approx(stats.wilcoxon(ranks, method="exact").pvalue)


def test_sign_flips_of_many_units_agree_with_the_t_test() -> None:
    values = np.random.default_rng(4).normal(0.4, 1.0, 40)
    found = sign_flip(values.tolist())
    assert found == sign_flip(values[::-1].tolist())
    assert found == pytest.approx(stats.ttest_1samp(values, 0).pvalue, abs=0.01)


def test_holm_on_a_worked_example() -> None:
    # sorted 0.005, 0.01, 0.03, 0.04 times 4, 3, 2, 1 is 0.02, 0.03, 0.06, 0.04; never falling: 0.06 at the end
    found = holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005})
    assert found == pytest.approx({"a": 0.03, "b": 0.06, "c": 0.06, "d": 0.02})


def test_holm_keeps_what_was_not_tested_apart() -> None:
    found = holm({"a": 0.03, "b": math.nan, "c": 0.02})
    assert (found["a"], found["c"]) == pytest.approx((0.04, 0.04))
    assert math.isnan(found["b"])


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0, 1, allow_subnormal=False), min_size=1, max_size=8))
def test_holm_lies_between_the_p_values_and_bonferroni(values: list[float]) -> None:
    found = holm(dict(enumerate(values)))
    for position, value in enumerate(values):
        assert value <= found[position] <= min(1.0, value * len(values))
    order = sorted(range(len(values)), key=values.__getitem__)
    assert [found[i] for i in order] == sorted(found.values())


def test_the_deviation_agrees_with_the_library() -> None:
    values = [0.3, 0.7, 0.1, 0.9]
    found = spread_over_seeds(sample({("a", i): [value] for i, value in enumerate(values)}))
    assert found.deviation == pytest.approx(statistics.stdev(values)) == pytest.approx(np.std(values, ddof=1))
