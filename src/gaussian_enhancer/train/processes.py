"""Launching of a job in several processes on one machine, by Lightning Fabric."""

import pickle
from collections.abc import Callable
from typing import Any

import torch
from lightning.fabric.utilities.rank_zero import rank_zero_only
from omegaconf import DictConfig

from gaussian_enhancer.cores import usable_cores
from gaussian_enhancer.errors import InputError, LostProcessError


def launched_externally() -> bool:
    """Whether torchrun or a cluster has already started the processes, so that each runs the whole command."""
    from lightning.fabric.plugins.environments import (
        LightningEnvironment,
        LSFEnvironment,
        MPIEnvironment,
        SLURMEnvironment,
        TorchElasticEnvironment,
    )

    kinds = (TorchElasticEnvironment, SLURMEnvironment, LSFEnvironment, MPIEnvironment)
    return LightningEnvironment().creates_processes_externally or any(kind.detect() for kind in kinds)


def is_first() -> bool:
    """Whether this process is the first of those that run the whole command."""
    return int(getattr(rank_zero_only, "rank", 0) or 0) == 0


def launch(work: Callable[..., Any], cfg: DictConfig, accelerator: str, count: int, *arguments: Any) -> Any:
    """Run a function in several processes and return the first process's result.

    Lightning's default would start the other processes by repeating the command line. In a sweep this would repeat the
    whole sweep, and in a notebook it does not work. Fabric spawns them instead. If one fails, the others are ended.

    Args:
        work: a function at module level, called with ``cfg`` and ``arguments``.
        cfg: the job's configuration; only the first process shows progress bars.
        accelerator: Lightning's name of the accelerator.
        count: number of processes; with 1 the function runs in this process.
        *arguments: further arguments of the function.

    Raises:
        InputError: the function raised it.
        LostProcessError: one of the processes was killed.
    """
    if count == 1:
        return work(cfg, *arguments)
    from lightning.fabric import Fabric

    if cfg.runtime.threads is None:
        cfg.runtime.threads = max(1, usable_cores() // count)
    fabric: Any = Fabric(accelerator=accelerator, devices=count, strategy="ddp_spawn")
    try:
        return pickle.loads(fabric.launch(_run_pickled, pickle.dumps((work, cfg, arguments))))
    except torch.multiprocessing.ProcessExitedException as error:
        raise LostProcessError(f"one of {count} processes was killed, for want of memory perhaps") from error
    except torch.multiprocessing.ProcessRaisedException as error:
        input_error = _parse_input_error(str(error))
        if input_error is None:
            raise
        raise input_error from None


def _run_pickled(fabric: Any, call: bytes) -> bytes:
    """Run the pickled call and pickle its result: Fabric would search unpickled frozen dataclasses for tensors.

    Lightning destroys only process groups of NCCL. A process that ends with one of gloo aborts in one of ten runs
    (pytorch/pytorch#190489).
    """
    work, cfg, arguments = pickle.loads(call)
    cfg.runtime.progress = cfg.runtime.progress and fabric.is_global_zero
    result = pickle.dumps(work(cfg, *arguments))
    if torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()
    return result


def _parse_input_error(traceback: str) -> InputError | None:
    """The InputError that ended a process, parsed from its traceback; None if another error ended it."""
    name = f"{InputError.__module__}.{InputError.__qualname__}: "
    lines = [line.removeprefix(name) for line in traceback.splitlines() if line.startswith(name)]
    if not lines:
        return None
    subject, _, message = lines[-1].partition(": ")
    received, _, remedy = message.partition("; ")
    return InputError(subject, received, remedy)
