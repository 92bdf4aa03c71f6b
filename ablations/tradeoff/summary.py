"""Summarises a setting's records of error and run time over views."""

import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from gaussian_enhancer.metrics.records import MISSING, Record
from gaussian_enhancer.metrics.tradeoff import mean_squared_error

TIME, LOW, HIGH = "milliseconds_per_megapixel", "lower_quartile", "upper_quartile"
"""Metrics of a timing record: median and quartiles over repeats, in milliseconds per megapixel of output."""


@dataclass(frozen=True)
class SettingSummary:
    """One setting over several views.

    Args:
        curve: the method.
        setting: its setting.
        milliseconds: per megapixel of output: median over views of the medians over repeats.
        low: median over views of the lower quartile over repeats.
        high: median over views of the upper quartile over repeats.
        psnr: mean over views, dB.
        dssim: 1 - SSIM, mean over views.
        perceptual: LPIPS by name, mean over views; distances that a view lacks are left out.
        memory: largest peak in megabytes; None if it was not measured.
        compile_seconds: largest time of compilation in seconds; None if nothing was compiled.
        views: number of views.
        megapixels: of an output image, median over views.
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
    compile_seconds: float | None = None
    views: int = 0
    megapixels: float = 0.0

    @property
    def name(self) -> str:
        """The name "curve/setting"."""
        return f"{self.curve}/{self.setting}"

    def error(self, metric: str) -> float | None:
        """The error in a metric; None if it was not measured.

        Args:
            metric: "mse" (from the mean PSNR: the geometric mean over views), "dissimilarity", or the name of an LPIPS.
        """
        if metric == "mse":
            return mean_squared_error(self.psnr)
        return self.dssim if metric == "dissimilarity" else self.perceptual.get(metric)


def summarise(records: Iterable[Record]) -> tuple[tuple[SettingSummary, ...], dict[str, str]]:
    """Summarise every setting over its views; settings that cannot be summarised are returned with reasons.

    A setting that lacks a view of another setting counts as missing, since its mean would be over different views.

    Args:
        records: kind "tradeoff" with `TIME`, psnr and ssim, or "missing"; ``variant`` is "curve/setting".

    Returns:
        Settings in the records' order, and reasons by "curve/setting".
    """
    records_by_setting: dict[str, list[Record]] = {}
    reasons: dict[str, str] = {}
    for record in records:
        if record.kind == MISSING:
            reasons.setdefault(record.variant, record.reasons["row"])
        else:
            records_by_setting.setdefault(record.variant, []).append(record)
    all_views = {_place(record) for setting_records in records_by_setting.values() for record in setting_records}
    for name, setting_records in records_by_setting.items():
        missing_views = len(all_views - {_place(record) for record in setting_records})
        if missing_views and name not in reasons:
            reasons[name] = f"measured on {len(all_views) - missing_views} of {len(all_views)} views"
    return tuple(
        _summary(name, setting_records) for name, setting_records in records_by_setting.items() if name not in reasons
    ), reasons


def _place(record: Record) -> tuple[str, str, str]:
    return record.scene, record.splat, record.view


def _summary(name: str, records: Sequence[Record]) -> SettingSummary:
    curve, _, setting = name.partition("/")
    milliseconds, low, high = (statistics.median(_values(records, key)) for key in (TIME, LOW, HIGH))
    lpips_names = {key for record in records for key in record.metrics if key.startswith("lpips")}
    lpips_values = {key: _values(records, key) for key in sorted(lpips_names)}
    return SettingSummary(
        curve,
        setting,
        milliseconds,
        low,
        high,
        statistics.fmean(_values(records, "psnr")),
        1 - statistics.fmean(_values(records, "ssim")),
        {key: statistics.fmean(values) for key, values in lpips_values.items() if len(values) == len(records)},
        max(_values(records, "peak_memory_mb"), default=None),
        max(_values(records, "compile_seconds"), default=None),
        len(records),
        statistics.median(record.size[0] * record.size[1] / 1e6 for record in records),
    )


def _values(records: Sequence[Record], metric: str) -> list[float]:
    return [value for record in records if (value := record.metrics.get(metric)) is not None]
