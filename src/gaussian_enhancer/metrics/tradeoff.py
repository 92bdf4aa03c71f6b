"""Error over run time: settings as points, the Pareto front, and the choice from it.

After the work-precision diagrams of the SciML benchmarks: every method at several settings, one axis the error, the
other the time, all measured in one run.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Point:
    """One setting.

    Args:
        name: of the setting.
        cost: run time, in any unit; finite and not negative.
        error: finite and not negative; 0 is exact.
    """

    name: str
    cost: float
    error: float

    def __post_init__(self) -> None:
        for what, value in (("cost", self.cost), ("error", self.error)):
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{what} of {self.name} is {value}, which is no finite number from 0")


def pareto_front(points: Iterable[Point]) -> tuple[Point, ...]:
    """The points that no other dominates, by rising cost.

    One point dominates another if it is neither dearer nor more wrong, and better in one of the two. Equal points do
    not dominate each other: all of them are on the front, or none.
    """
    kept: list[Point] = []
    for point in sorted(points, key=lambda one: (one.cost, one.error)):
        last = kept[-1] if kept else None
        if last is None or point.error < last.error or (point.cost, point.error) == (last.cost, last.error):
            kept.append(point)
    return tuple(kept)


def cheapest_within(points: Iterable[Point], most: float) -> Point | None:
    """The cheapest point whose error is at most so large, of equally cheap ones the most exact; None without one."""
    return min((one for one in points if one.error <= most), key=lambda one: (one.cost, one.error), default=None)


def best_within(points: Iterable[Point], budget: float) -> Point | None:
    """The most exact point that costs at most so much, of equally exact ones the cheapest; None without one."""
    return min((one for one in points if one.cost <= budget), key=lambda one: (one.error, one.cost), default=None)


def mean_squared_error(psnr: float) -> float:
    """The mean squared error of images in [0, 1] that have so many decibels."""
    return 10 ** (-psnr / 10)


def error_above_best(points: Sequence[Point], decibels: float) -> float:
    """The error that lies so many decibels above the least one.

    Args:
        points: at least one.
        decibels: not negative.
    """
    return min(one.error for one in points) * 10 ** (decibels / 10)
