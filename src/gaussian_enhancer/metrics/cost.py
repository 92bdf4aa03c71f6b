"""Run time (median of interleaved repeats) and peak memory of a computation."""

import gc
import math
import statistics
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import psutil
import torch

from gaussian_enhancer import memory

Call = Callable[[], object]
RESET_SLACK = 16 * 2**20
"""Bytes by which a high-water mark that was just reset may exceed the resident memory."""


@dataclass(frozen=True)
class Timing:
    """Wall-clock times of one computation.

    Args:
        milliseconds: median over the repeats.
        repeats: every repeat in milliseconds, in order.
    """

    milliseconds: float
    repeats: tuple[float, ...]

    @property
    def deviation(self) -> float:
        """Standard deviation over repeats (ddof=1), in milliseconds; 0 for a single repeat."""
        return statistics.stdev(self.repeats) if len(self.repeats) > 1 else 0.0

    @property
    def quartiles(self) -> tuple[float, float]:
        """Lower and upper quartile over repeats, interpolated, in milliseconds; equal for a single repeat."""
        if len(self.repeats) == 1:
            return self.repeats[0], self.repeats[0]
        low, _, high = statistics.quantiles(self.repeats, n=4, method="inclusive")
        return low, high

    def times_faster(self, other: "Timing") -> tuple[float, float, float]:
        """Speed-up over a computation whose timing was interleaved with this one, with its 95% interval.

        Returns the median of the ratios of corresponding repeats, which cancels slow-downs of the machine that last
        longer than a repeat of both, and the order statistics that enclose the median with a probability of 95%. With
        fewer than six repeats these are the smallest and largest ratio.
        """
        ratios = sorted(other_time / own_time for own_time, other_time in zip(self.repeats, other.repeats, strict=True))
        count, below = len(ratios), 0
        while sum(math.comb(count, k) for k in range(below + 1)) <= 0.025 * 2**count:
            below += 1
        lower = max(0, below - 1)
        return statistics.median(ratios), ratios[lower], ratios[count - 1 - lower]


def device_description(device: torch.device) -> str:
    """Text for a protocol that describes the device of a timing, with the number of CPU threads."""
    return "GPU" if device.type == "cuda" else f"CPU, {torch.get_num_threads()} threads"


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


def peak_memory(call: Call, device: torch.device | str = "cpu") -> int:
    """Peak memory in bytes while a computation runs.

    On CUDA this is the peak of allocated device memory, on the CPU the peak resident memory of the whole process. Where
    the system does not let a process reset its high-water mark (outside Linux, in some containers), resident memory is
    read every millisecond instead, which can miss shorter peaks.

    Args:
        call: the computation.
        device: device of the computation.
    """
    device = torch.device(device)
    gc.collect()
    if device.type == "cuda":
        torch.cuda.synchronize(device)
        torch.cuda.reset_peak_memory_stats(device)
        call()
        torch.cuda.synchronize(device)
        return torch.cuda.max_memory_allocated(device)
    memory.release_freed_memory()
    if _reset_high_water_mark():
        call()
        return _resident("VmHWM")
    return _polled_peak(call)


def _time_once(call: Call, device: torch.device) -> float:
    _synchronise(device)
    start = time.perf_counter()
    call()
    _synchronise(device)
    return (time.perf_counter() - start) * 1e3


def _synchronise(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def _reset_high_water_mark() -> bool:
    """Reset the process's recorded peak memory to its present use; return whether the system did so."""
    clear_refs = Path("/proc/self/clear_refs")
    if not clear_refs.exists():
        return False
    try:
        clear_refs.write_text("5")
    except OSError:
        return False
    return _resident("VmHWM") - _resident("VmRSS") < RESET_SLACK


def _resident(field: str) -> int:
    """Resident memory in bytes as counted by Linux: current (VmRSS) or peak (VmHWM)."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(field))
    return int(line.split()[1]) * 1024


def _polled_peak(call: Call) -> int:
    """Peak resident memory while a computation runs, polled by a thread."""
    process = psutil.Process()
    highest = process.memory_info().rss
    finished = threading.Event()

    def watch() -> None:
        nonlocal highest
        while not finished.wait(1e-3):
            highest = max(highest, process.memory_info().rss)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        call()
    finally:
        finished.set()
        watcher.join()
    return max(highest, process.memory_info().rss)
