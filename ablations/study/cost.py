"""Spread and ratio of interleaved run times, and peak memory of a computation."""

import gc
import math
import statistics
import threading
from pathlib import Path

import psutil
import torch

from gaussian_enhancer import memory
from gaussian_enhancer.metrics.cost import Call, Timing

RESET_SLACK = 16 * 2**20
"""Bytes by which a high-water mark that was just reset may exceed the resident memory."""


def deviation(timing: Timing) -> float:
    """Standard deviation over repeats (ddof=1), in milliseconds; 0 for a single repeat."""
    return statistics.stdev(timing.repeats) if len(timing.repeats) > 1 else 0.0


def quartiles(timing: Timing) -> tuple[float, float]:
    """Lower and upper quartile over repeats, interpolated, in milliseconds; equal for a single repeat."""
    if len(timing.repeats) == 1:
        return timing.repeats[0], timing.repeats[0]
    low, _, high = statistics.quantiles(timing.repeats, n=4, method="inclusive")
    return low, high


def times_faster(timing: Timing, other: Timing) -> tuple[float, float, float]:
    """Speed-up of a computation over another, with its 95% interval.

    Returns the median of the ratios of corresponding repeats, which cancels slow-downs of the machine that last
    longer than a repeat of both, and the order statistics that enclose the median with a probability of 95%. With
    fewer than six repeats these are the smallest and largest ratio.

    Args:
        timing: of the computation.
        other: of the other one, whose repeats were interleaved with those of the first.
    """
    ratios = sorted(other_time / own_time for own_time, other_time in zip(timing.repeats, other.repeats, strict=True))
    count, below = len(ratios), 0
    while sum(math.comb(count, k) for k in range(below + 1)) <= 0.025 * 2**count:
        below += 1
    lower = max(0, below - 1)
    return statistics.median(ratios), ratios[lower], ratios[count - 1 - lower]


def device_description(device: torch.device) -> str:
    """Text for a protocol that describes the device of a timing, with the number of CPU threads."""
    return "GPU" if device.type == "cuda" else f"CPU, {torch.get_num_threads()} threads"


def memory_description(device: torch.device) -> str:
    """Text for a protocol that says which memory `peak_memory` measures."""
    return "allocated on the device" if device.type == "cuda" else "of the whole process"


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
