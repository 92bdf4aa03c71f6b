"""Pareto front of error over run time, and the cheapest setting within an error."""

from collections.abc import Iterable, Sequence

from gaussian_enhancer.metrics.tradeoff import Point


def pareto_front(points: Iterable[Point]) -> tuple[Point, ...]:
    """The points that no other point dominates, in order of increasing cost.

    A point dominates another if neither its cost nor its error is larger, and at least one of them is smaller. Equal
    points do not dominate each other: all of them are on the front, or none.
    """
    front: list[Point] = []
    for point in sorted(points, key=lambda point: (point.cost, point.error)):
        last = front[-1] if front else None
        if last is None or point.error < last.error or (point.cost, point.error) == (last.cost, last.error):
            front.append(point)
    return tuple(front)


def cheapest_within(points: Iterable[Point], max_error: float) -> Point | None:
    """The cheapest point whose error is at most ``max_error``; ties go to the smaller error. None if there is none."""
    permitted = (point for point in points if point.error <= max_error)
    return min(permitted, key=lambda point: (point.cost, point.error), default=None)


def error_above_best(points: Sequence[Point], decibels: float) -> float:
    """The smallest error of the points, increased by a number of decibels.

    Args:
        points: at least one.
        decibels: increase in dB, not negative.
    """
    return min(point.error for point in points) * 10 ** (decibels / 10)
