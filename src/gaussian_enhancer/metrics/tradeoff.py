"""Error over run time: settings as points, the Pareto front, and what to choose from it.

After the work-precision diagrams of the SciML benchmarks: every method at several settings, one axis the error, the
other the time, all measured in one run.
"""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from gaussian_enhancer.metrics.records import MISSING, Record

TIME, LOW, HIGH = "milliseconds_per_megapixel", "lower_quartile", "upper_quartile"
"""Metrics of a record of time: median and quartiles over repeats, milliseconds a megapixel of output."""


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


def front(points: Iterable[Point]) -> tuple[Point, ...]:
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


def mean_squared(psnr: float) -> float:
    """The mean squared error of images in [0, 1] that have so many decibels."""
    return 10 ** (-psnr / 10)


def beyond_best(points: Sequence[Point], decibels: float) -> float:
    """The error that lies so many decibels above the least one.

    Args:
        points: at least one.
        decibels: not negative.
    """
    return min(one.error for one in points) * 10 ** (decibels / 10)


@dataclass(frozen=True)
class SettingSummary:
    """One setting over several views.

    Args:
        curve: the method.
        setting: its setting.
        milliseconds: a megapixel of output: median over views of the medians over repeats.
        low: median over views of the lower quartile over repeats.
        high: the same of the upper quartile.
        psnr: mean over views, dB.
        dissimilarity: 1 - SSIM, mean over views.
        perceptual: LPIPS by name, mean over views; without those that some view lacks.
        memory: largest peak in megabytes; None where it was not measured.
        compiling: seconds that compilation took; None where nothing was compiled.
        views: number of views.
        megapixels: of an output image, the median over views.
    """

    curve: str
    setting: str
    milliseconds: float
    low: float
    high: float
    psnr: float
    dssim: float
    perceptual: Mapping[str, float] = field(default_factory=dict)
    memory: float | None = None
    compiling: float | None = None
    views: int = 0
    megapixels: float = 0.0

    @property
    def name(self) -> str:
        """Method and setting."""
        return f"{self.curve}/{self.setting}"

    def error(self, metric: str) -> float | None:
        """The error that a metric's name stands for.

        Args:
            metric: "mse" (of the mean PSNR: the geometric mean over views), "dissimilarity", or an LPIPS's name.
        """
        if metric == "mse":
            return mean_squared(self.psnr)
        return self.dssim if metric == "dissimilarity" else self.perceptual.get(metric)


def summarised(records: Iterable[Record]) -> tuple[tuple[SettingSummary, ...], dict[str, str]]:
    """Every setting over the views of its records, and why others are missing.

    A setting that lacks a view which another has is missing: its mean would be over other views.

    Args:
        records: kind "tradeoff" with `TIME`, psnr and ssim, or "missing"; ``variant`` is "curve/setting".

    Returns:
        Settings in the records' order, and reasons by "curve/setting".
    """
    found: dict[str, list[Record]] = {}
    reasons: dict[str, str] = {}
    for record in records:
        if record.kind == MISSING:
            reasons.setdefault(record.variant, record.reasons["row"])
        else:
            found.setdefault(record.variant, []).append(record)
    every = {_place(record) for own in found.values() for record in own}
    for name, own in found.items():
        lacking = len(every - {_place(record) for record in own})
        if lacking and name not in reasons:
            reasons[name] = f"measured on {len(every) - lacking} of {len(every)} views"
    return tuple(_summary(name, own) for name, own in found.items() if name not in reasons), reasons


def _place(record: Record) -> tuple[str, str, str]:
    return record.scene, record.splat, record.view


def _summary(name: str, records: Sequence[Record]) -> SettingSummary:
    curve, _, setting = name.partition("/")
    times = {key: statistics.median(_values(records, key)) for key in (TIME, LOW, HIGH)}
    perceptual = {key for record in records for key in record.metrics if key.startswith("lpips")}
    known = {key: _values(records, key) for key in sorted(perceptual)}
    return SettingSummary(
        curve,
        setting,
        times[TIME],
        times[LOW],
        times[HIGH],
        statistics.fmean(_values(records, "psnr")),
        1 - statistics.fmean(_values(records, "ssim")),
        {key: statistics.fmean(values) for key, values in known.items() if len(values) == len(records)},
        max(_values(records, "peak_memory_mb"), default=None),
        max(_values(records, "compile_seconds"), default=None),
        len(records),
        statistics.median(record.size[0] * record.size[1] / 1e6 for record in records),
    )


def _values(records: Sequence[Record], metric: str) -> list[float]:
    return [value for record in records if (value := record.metrics.get(metric)) is not None]
