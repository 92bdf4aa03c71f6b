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
RESET_SLACK = 16 * 2**20  # bytes by which a mark that was just reset may lie above what is held


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
        """Standard deviation over repeats (ddof=1), milliseconds; 0 for a single one."""
        return statistics.stdev(self.repeats) if len(self.repeats) > 1 else 0.0

    @property
    def quartiles(self) -> tuple[float, float]:
        """Lower and upper quartile over repeats, interpolated, in milliseconds; equal for a single repeat."""
        if len(self.repeats) == 1:
            return self.repeats[0], self.repeats[0]
        low, _, high = statistics.quantiles(self.repeats, n=4, method="inclusive")
        return low, high

    def times_faster(self, other: "Timing") -> tuple[float, float, float]:
        """Speed-up over a computation that was timed in turn with this one, with its interval.

        Returns the median of the rounds' ratios, which cancels slow-downs of the machine that last longer than a round,
        and the order statistics that enclose the median in 95 % of all cases; with fewer than six rounds, the range.
        """
        ratios = sorted(their_time / our_time for our_time, their_time in zip(self.repeats, other.repeats, strict=True))
        count, below = len(ratios), 0
        while sum(math.comb(count, k) for k in range(below + 1)) <= 0.025 * 2**count:
            below += 1
        outside = max(0, below - 1)
        return statistics.median(ratios), ratios[outside], ratios[count - 1 - outside]


def device_description(device: torch.device) -> str:
    """What a protocol says of the device that times were measured on, threads of the CPU included."""
    return "GPU" if device.type == "cuda" else f"CPU, {torch.get_num_threads()} threads"


def time_interleaved(
    calls: Mapping[str, Call], repeats: int = 9, warm_up: int = 2, device: torch.device | str = "cpu"
) -> dict[str, Timing]:
    """Time several computations against each other, one repeat of each in turn, in alternating order.

    Interleaving lets a slow spell of the machine strike all of them alike; the median ignores single hiccups; the
    warm-up takes compilation, caches and autotuning out.

    Args:
        calls: computations by name, without arguments.
        repeats: measured repeats of each, at least 1.
        warm_up: unmeasured repeats of each before that.
        device: where they compute; on CUDA the device is waited for.
    """
    if repeats < 1:
        raise ValueError(f"repeats must be at least 1, got {repeats}")
    for _ in range(warm_up):
        for call in calls.values():
            call()
    times: dict[str, list[float]] = {name: [] for name in calls}
    turns = list(calls.items())
    for _ in range(repeats):
        for name, call in turns:
            times[name].append(_time_once(call, torch.device(device)))
        turns.reverse()  # what comes second finds another machine
    return {name: Timing(statistics.median(values), tuple(values)) for name, values in times.items()}


def peak_memory(call: Call, device: torch.device | str = "cpu") -> int:
    """Largest memory in bytes while a computation runs.

    On CUDA the peak of allocated device memory; on the CPU the peak of the whole process's resident memory. Where the
    system does not let a process reset its high-water mark (outside Linux, in some containers), resident memory is read
    every millisecond instead, which can miss a shorter peak.

    Args:
        call: the computation.
        device: where it computes.
    """
    device = torch.device(device)
    gc.collect()
    if device.type == "cuda":
        torch.cuda.synchronize(device)
        torch.cuda.reset_peak_memory_stats(device)
        call()
        torch.cuda.synchronize(device)
        return torch.cuda.max_memory_allocated(device)
    memory.give_back()
    if _reset_high_water_mark():
        call()
        return _resident("VmHWM")
    return _watched_peak(call)


def _time_once(call: Call, device: torch.device) -> float:
    _wait(device)
    start = time.perf_counter()
    call()
    _wait(device)
    return (time.perf_counter() - start) * 1e3


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def _reset_high_water_mark() -> bool:
    """Reset the process's recorded peak memory to its present use; return whether the system did so."""
    switch = Path("/proc/self/clear_refs")
    if not switch.exists():
        return False
    try:
        switch.write_text("5")
    except OSError:
        return False
    return _resident("VmHWM") - _resident("VmRSS") < RESET_SLACK


def _resident(field: str) -> int:
    """Resident memory in bytes, now (VmRSS) or at its highest (VmHWM), as Linux counts it."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(field))
    return int(line.split()[1]) * 1024


def _watched_peak(call: Call) -> int:
    """Highest resident memory that a watching thread sees while a computation runs."""
    process = psutil.Process()
    highest = process.memory_info().rss
    done = threading.Event()

    def watch() -> None:
        nonlocal highest
        while not done.wait(1e-3):
            highest = max(highest, process.memory_info().rss)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        call()
    finally:
        done.set()
        watcher.join()
    return max(highest, process.memory_info().rss)
