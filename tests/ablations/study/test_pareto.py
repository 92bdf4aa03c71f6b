"""Pareto fronts and choices, against their definitions."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ablations.study.pareto import cheapest_within, error_above_best, pareto_front
from gaussian_enhancer.metrics.tradeoff import Point, best_within

GRID = st.integers(0, 6).map(float)  # few values, so that ties are common
POINTS = st.lists(st.tuples(GRID, GRID), max_size=12).map(
    lambda pairs: [Point(str(i), cost, error) for i, (cost, error) in enumerate(pairs)]
)


def dominates(a: Point, b: Point) -> bool:
    return a.cost <= b.cost and a.error <= b.error and (a.cost, a.error) != (b.cost, b.error)


@given(POINTS)
def test_the_front_is_what_nothing_dominates(points) -> None:
    assert set(pareto_front(points)) == {one for one in points if not any(dominates(other, one) for other in points)}


@given(POINTS)
def test_the_front_rises_in_cost_and_falls_in_error_and_is_its_own_front(points) -> None:
    found = pareto_front(points)
    assert list(found) == sorted(found, key=lambda one: (one.cost, -one.error))
    assert pareto_front(found) == found
    assert bool(found) == bool(points)


@given(POINTS, st.randoms())
def test_order_does_not_matter(points, random) -> None:
    shuffled = points.copy()
    random.shuffle(shuffled)
    assert set(pareto_front(shuffled)) == set(pareto_front(points))


def test_known_fronts() -> None:
    one = Point("one", 1.0, 1.0)
    assert pareto_front([]) == ()
    assert pareto_front([one]) == (one,)
    twin, dear, wrong = Point("twin", 1.0, 1.0), Point("dear", 2.0, 1.0), Point("wrong", 1.0, 2.0)
    assert set(pareto_front([dear, one, wrong, twin])) == {one, twin}


@given(POINTS, GRID)
def test_choices_keep_their_limit_and_no_point_within_it_is_better(points, limit) -> None:
    cheap, good = cheapest_within(points, limit), best_within(points, limit)
    exact = [one for one in points if one.error <= limit]
    fast = [one for one in points if one.cost <= limit]
    assert (cheap is None, good is None) == (not exact, not fast)
    if cheap is not None:
        assert cheap in exact
        assert not any(other.cost < cheap.cost or dominates(other, cheap) for other in exact)
        assert (cheap.cost, cheap.error) in {(one.cost, one.error) for one in pareto_front(points)}
    if good is not None:
        assert good in fast
        assert not any(other.error < good.error or dominates(other, good) for other in fast)
        assert (good.cost, good.error) in {(one.cost, one.error) for one in pareto_front(points)}


@given(POINTS.filter(bool), st.floats(0.0, 3.0, allow_subnormal=False))
def test_within_so_many_decibels_of_the_best_holds_the_best_itself(points, decibels) -> None:
    limit = error_above_best(points, decibels)
    best = min(points, key=lambda one: one.error)
    assert limit >= best.error
    if best.error:
        assert 10 * math.log10(limit / best.error) == pytest.approx(decibels, abs=1e-9)
