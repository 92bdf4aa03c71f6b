"""Formatting and direction of improvement of each metric, shared by all pages and tables."""

import math
from dataclasses import dataclass

from gaussian_enhancer.metrics.records import HIGHER_IS_BETTER


@dataclass(frozen=True)
class Quantity:
    """A metric as shown to readers.

    Args:
        key: the metric's name in the records.
        label: the name on the page.
        decimals: digits after the decimal point.
        unit: unit after the number, without a blank; empty if there is none.
        meaning: short explanation of the metric, shown on demand.
    """

    key: str
    label: str
    decimals: int
    unit: str = ""
    meaning: str = ""

    @property
    def higher_is_better(self) -> bool | None:
        """Direction of improvement; None if the metric has no known direction."""
        return HIGHER_IS_BETTER.get(self.key)

    def format_value(self, value: float) -> str:
        """Format a value; ``∞``, ``−∞`` and ``–`` (NaN) stand for values that are not finite."""
        if math.isnan(value):
            return "–"
        if math.isinf(value):
            return "∞" if value > 0 else "−∞"
        return f"{value:.{self.decimals}f}".replace("-", "−")

    def format_gain(self, gain: float) -> str:
        """Format a difference with its sign; ``±0``, with the metric's decimals, if it rounds to zero."""
        if not math.isfinite(gain):
            return self.format_value(gain)
        if round(gain, self.decimals) == 0:
            return f"±{0:.{self.decimals}f}"
        return f"{gain:+.{self.decimals}f}".replace("-", "−")

    def verdict(self, gain: float) -> str:
        """``better``, ``worse``, or ``same``: the difference rounds to zero, is NaN, or has no known direction."""
        if math.isnan(gain) or self.higher_is_better is None:
            return "same"
        if math.isfinite(gain) and round(gain, self.decimals) == 0:
            return "same"
        return "better" if (gain > 0) == self.higher_is_better else "worse"


KNOWN = (
    Quantity("psnr", "PSNR", 2, "dB", "peak signal-to-noise ratio of 8-bit images"),
    Quantity("psnr_aligned", "PSNR aligned", 2, "dB", "PSNR after the best affine colour map to the photo"),
    Quantity("psnr_masked", "PSNR object", 2, "dB", "PSNR over the object's pixels"),
    Quantity("ssim", "SSIM", 4, "", "structural similarity, 11×11 window, sigma 1.5"),
    Quantity("lpips_alex", "LPIPS alex", 4, "", "perceptual distance, AlexNet; lower is better"),
    Quantity("lpips_squeeze", "LPIPS squeeze", 4, "", "perceptual distance, SqueezeNet; lower is better"),
    Quantity("lpips_vgg", "LPIPS vgg", 4, "", "perceptual distance, VGG; lower is better"),
    Quantity("lpips_vgg_raw", "LPIPS vgg raw", 4, "", "VGG on [0, 1] as in 3DGS's tables; lower is better"),
    Quantity("milliseconds", "time", 1, "ms", "run time of one image; lower is better"),
    Quantity("peak_memory_mb", "memory", 0, "MB", "peak memory; lower is better"),
    Quantity("gaussians", "Gaussians", 0, "", "number of Gaussians in the splat"),
)
"""Metrics of the pinned protocol, in the order in which they are shown."""

RANKING_METRICS = ("psnr_aligned", "psnr", "psnr_masked")
"""The first of these metrics that was measured determines the worst view."""


def quantities(keys: set[str]) -> tuple[Quantity, ...]:
    """The metrics with these keys: known ones in the order of `KNOWN`, then others by name, without a direction."""
    known_quantities = tuple(quantity for quantity in KNOWN if quantity.key in keys)
    unknown_keys = sorted(keys - {quantity.key for quantity in KNOWN})
    return known_quantities + tuple(Quantity(key, key, 4) for key in unknown_keys)
