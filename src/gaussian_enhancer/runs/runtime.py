"""Settings of a job's process: device, threads and memory."""

import os
import sys

import torch
from omegaconf import DictConfig

from gaussian_enhancer import memory
from gaussian_enhancer.cores import usable_cores
from gaussian_enhancer.errors import InputError


def start(runtime: DictConfig) -> torch.device:
    """Choose the device, and set the number of CPU threads and the reuse of freed memory for this process.

    Args:
        runtime: ``device`` (auto, cpu or cuda); ``threads`` (None uses all cores); ``keep_memory``: keep freed memory
            for later allocations instead of returning it to the system.

    Raises:
        InputError: the device is unknown or absent.
    """
    threads = usable_cores() if runtime.threads is None else runtime.threads
    if runtime.keep_memory:
        memory.retain_freed_memory()
    torch.set_num_threads(threads)
    torch.set_flush_denormal(True)  # denormals (below 1e-38) are tens of times slower and irrelevant to the results
    set_kernel_threads(threads)
    return choose_device(runtime.device)


def set_kernel_threads(threads: int) -> None:
    """Set the number of threads of compiled kernels, unless ``NUMBA_NUM_THREADS`` is set.

    Numba reads the variable when it is imported and whenever it compiles, and launches its threads when the first
    kernel runs. If the variable has changed by the next compilation, it raises an error. Until the launch, the variable
    is therefore read anew here; afterwards, the kernels of the calling thread can only be restricted to some of the
    threads. Launching them here would break kernels in forked processes.

    Args:
        threads: number of threads.
    """
    launcher = sys.modules.get("numba.np.ufunc.parallel")
    if launcher is not None and launcher._is_initialized:
        launcher.set_num_threads(min(threads, launcher.config.NUMBA_NUM_THREADS))
        return
    os.environ.setdefault("NUMBA_NUM_THREADS", str(threads))
    if launcher is not None:
        launcher.config.reload_config()
        vars(launcher)["NUM_THREADS"] = launcher.config.NUMBA_NUM_THREADS  # of the launch


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
