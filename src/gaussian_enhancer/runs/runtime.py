"""Settings of a job's process: device, threads and memory."""

import os

import torch
from omegaconf import DictConfig

from gaussian_enhancer import memory
from gaussian_enhancer.errors import InputError


def start(runtime: DictConfig) -> torch.device:
    """Choose the device, and set the number of CPU threads and the reuse of freed memory for this process.

    Args:
        runtime: ``device`` (auto, cpu or cuda); ``threads`` (None uses all cores); ``keep_memory``: keep freed memory
            for later allocations instead of returning it to the system.

    Raises:
        InputError: the device is unknown or absent, or the thread count is not positive.
    """
    threads = len(os.sched_getaffinity(0)) if runtime.threads is None else runtime.threads
    if not isinstance(threads, int) or threads < 1:
        raise InputError("runtime.threads", f"is {threads!r}", "give a positive number or null")
    if runtime.keep_memory:
        memory.retain_freed_memory()
    torch.set_num_threads(threads)
    torch.set_flush_denormal(True)  # denormals (below 1e-38) are tens of times slower and irrelevant to the results
    os.environ.setdefault("NUMBA_NUM_THREADS", str(threads))
    return choose_device(runtime.device)


def choose_device(name: str) -> torch.device:
    """The device of a name; ``auto`` selects CUDA if it is available.

    Raises:
        InputError: the name is unknown, or there is no CUDA device.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if name not in ("cpu", "cuda"):
        raise InputError("runtime.device", f"is {name!r}", "choose auto, cpu or cuda")
    if name == "cuda" and not torch.cuda.is_available():
        raise InputError("runtime.device", "is 'cuda', but torch finds no CUDA device", "choose cpu or auto")
    return torch.device(name)
