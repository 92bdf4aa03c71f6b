"""Trade-off of error and run time: settings as points, their Pareto front, and selection of a setting.

After the work-precision diagrams of the SciML benchmarks, which show error over run time for every method at several
settings, all measured in one run.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Point:
    """Run time and error of one setting.

    Args:
        name: the setting's name.
        cost: run time, in any unit; finite and not negative.
        error: error, in any unit; finite and not negative.
    """

    name: str
    cost: float
    error: float

    def __post_init__(self) -> None:
        for name, value in (("cost", self.cost), ("error", self.error)):
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} of {self.name} is {value}, which is no finite number from 0")


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


def best_within(points: Iterable[Point], max_cost: float) -> Point | None:
    """The point of smallest error whose cost is at most ``max_cost``; ties go to the cheaper. None if there is none."""
    permitted = (point for point in points if point.cost <= max_cost)
    return min(permitted, key=lambda point: (point.error, point.cost), default=None)


def mean_squared_error(psnr: float) -> float:
    """Mean squared error of images in [0, 1] with this PSNR in dB."""
    return 10 ** (-psnr / 10)


def error_above_best(points: Sequence[Point], decibels: float) -> float:
    """The smallest error of the points, increased by a number of decibels.

    Args:
        points: at least one.
        decibels: increase in dB, not negative.
    """
    return min(point.error for point in points) * 10 ** (decibels / 10)
