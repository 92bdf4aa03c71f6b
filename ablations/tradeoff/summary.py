"""A setting's records of error and run time, summed up over views."""

import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from gaussian_enhancer.metrics.records import MISSING, Record
from gaussian_enhancer.metrics.tradeoff import mean_squared

TIME, LOW, HIGH = "milliseconds_per_megapixel", "lower_quartile", "upper_quartile"
"""Metrics of a record of time: median and quartiles over repeats, milliseconds a megapixel of output."""


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
