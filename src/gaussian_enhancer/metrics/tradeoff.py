"""Trade-off of error and run time: settings as points, and selection of a setting.

After the work-precision diagrams of the SciML benchmarks, which show error over run time for every method at several
settings, all measured in one run.
"""

import math
from collections.abc import Iterable
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


def best_within(points: Iterable[Point], max_cost: float) -> Point | None:
    """The point of smallest error whose cost is at most ``max_cost``; ties go to the cheaper. None if there is none."""
    permitted = (point for point in points if point.cost <= max_cost)
    return min(permitted, key=lambda point: (point.error, point.cost), default=None)


def mean_squared_error(psnr: float) -> float:
    """Mean squared error of images in [0, 1] with this PSNR in dB."""
    return 10 ** (-psnr / 10)
