"""Run time of a computation: median of interleaved repeats."""

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch

Call = Callable[[], object]


@dataclass(frozen=True)
class Timing:
    """Wall-clock times of one computation.

    Args:
        milliseconds: median over the repeats.
        repeats: every repeat in milliseconds, in order.
    """

    milliseconds: float
    repeats: tuple[float, ...]


def time_interleaved(
    calls: Mapping[str, Call], repeats: int = 9, warm_up: int = 2, device: torch.device | str = "cpu"
) -> dict[str, Timing]:
    """Time several computations with interleaved repeats, whose order is reversed each time.

    With interleaving, a temporary slow-down of the machine affects all computations alike. The median ignores single
    outliers. The warm-up excludes compilation, cache misses and autotuning.

    Args:
        calls: computations by name, without arguments.
        repeats: measured repeats of each, at least 1.
        warm_up: unmeasured repeats of each, run first.
        device: device of the computations; a CUDA device is synchronised before and after each.
    """
    if repeats < 1:
        raise ValueError(f"repeats must be at least 1, got {repeats}")
    for _ in range(warm_up):
        for call in calls.values():
            call()
    times: dict[str, list[float]] = {name: [] for name in calls}
    order = list(calls.items())
    for _ in range(repeats):
        for name, call in order:
            times[name].append(_time_once(call, torch.device(device)))
        order.reverse()  # the position in a round affects the time, through caches for instance
    return {name: Timing(statistics.median(values), tuple(values)) for name, values in times.items()}


def _time_once(call: Call, device: torch.device) -> float:
    _synchronise(device)
    start = time.perf_counter()
    call()
    _synchronise(device)
    return (time.perf_counter() - start) * 1e3


def _synchronise(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)
