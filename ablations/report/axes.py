"""Logarithmic axes: where values lie on them, and the round numbers that they are marked with."""

import math
from collections.abc import Iterable
from dataclasses import dataclass


def ticks(low: float, high: float, most: int = 6) -> tuple[float, ...]:
    """Round numbers between two positive ones, evenly enough spaced on a logarithmic axis.

    Powers of ten over three decades and more, 1, 2 and 5 times these over one and more, a round step below that.
    """
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    span = math.log10(high / low)
    if span >= 1:
        factors: tuple[float, ...] = (1,) if span >= 3 else (1, 2, 5) if span < 2 else (1, 3)
        stride = -(-(last - first + 1) // (most + 2))
        found = [factor * 10.0**power for power in range(first, last + 1, stride) for factor in factors]
    else:
        rough = (high - low) / most
        unit = 10.0 ** math.floor(math.log10(rough)) if rough > 0 else low
        step = next(factor * unit for factor in (1, 2, 5, 10) if factor * unit >= rough)
        found = [step * index for index in range(math.ceil(low / step), math.floor(high / step) + 1)]
    return tuple(value for value in found if low <= value <= high * (1 + 1e-9))


@dataclass(frozen=True)
class Axis:
    """A logarithmic axis.

    Args:
        low: value at 0.
        high: value at the end, larger.
        length: in pixels.
    """

    low: float
    high: float
    length: float

    def __call__(self, value: float) -> float:
        """Pixels from the axis's beginning."""
        return self.length * math.log(value / self.low) / math.log(self.high / self.low)


def axis(values: Iterable[float], length: float) -> Axis:
    """An axis that holds positive values with a margin; a tenth of a decade at least."""
    logs = [math.log10(value) for value in values] or [0.0]
    margin = max(0.06 * (max(logs) - min(logs)), 0.02)
    return Axis(10 ** (min(logs) - margin), 10 ** (max(logs) + margin), length)


def told(value: float) -> str:
    """A number for an axis: powers of ten that are far from 1 as such."""
    power = math.log10(value)
    if abs(power - round(power)) < 1e-9 and not -3 <= round(power) <= 5:
        return "10" + str(round(power)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{value:.10g}" if 1e-4 <= value < 1e6 else f"{value:.2g}"
