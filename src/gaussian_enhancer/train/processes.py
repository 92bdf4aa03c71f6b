"""Several processes of one machine that do a job together, joined as Lightning's DDP joins them."""

import os
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
import torch.multiprocessing
from omegaconf import DictConfig

from gaussian_enhancer.errors import InputError


@dataclass(frozen=True)
class Place:
    """One process among those that work together.

    Args:
        rank: its number.
        ranks: how many there are.
        port: where they meet; None where they do not.
    """

    rank: int = 0
    ranks: int = 1
    port: int | None = None

    def options(self) -> dict[str, Any]:
        """What Lightning's trainer is told: who belongs together, and that samples are split already."""
        if self.port is None:
            return {}
        from lightning.pytorch.strategies import DDPStrategy

        from gaussian_enhancer.train.team import Team

        # Nothing is sent between two steps but gradients: processes may have unequal numbers of views.
        strategy = DDPStrategy(find_unused_parameters=True, broadcast_buffers=False)
        team = Team(self.rank, self.port)
        return {"strategy": strategy, "devices": self.ranks, "plugins": [team], "use_distributed_sampler": False}


def together(work: Callable[[DictConfig, Place], Any], cfg: DictConfig, processes: int) -> Any:
    """Do a work in several processes and return what the first of them returns.

    Where one of them fails or is killed the others are ended, and where this process is killed they end as well.

    Args:
        work: a function at the top of a module, or a partial of one.
        cfg: the job's configuration; progress bars are the first process's alone.
        processes: how many; with one the work is done in this process.

    Raises:
        InputError: the work refuses its input.
    """
    if processes == 1:
        return work(cfg, Place())
    answers = torch.multiprocessing.get_context("spawn").SimpleQueue()
    try:
        torch.multiprocessing.spawn(_other, (work, cfg, processes, free_port(), answers), processes)
    except torch.multiprocessing.ProcessExitedException:
        refusal = None if answers.empty() else answers.get()
        if not isinstance(refusal, InputError):
            raise
        raise refusal from None
    return answers.get()


def _other(
    rank: int, work: Callable[[DictConfig, Place], Any], cfg: DictConfig, processes: int, port: int, answers: Any
) -> None:
    cfg.runtime.progress = cfg.runtime.progress and rank == 0
    if cfg.runtime.threads is None:
        cfg.runtime.threads = max(1, len(os.sched_getaffinity(0)) // processes)
    try:
        answer = work(cfg, Place(rank, processes, port))
    except InputError as error:
        answers.put(error)
        raise SystemExit(2) from error
    if rank == 0:
        answers.put(answer)


def free_port() -> int:
    """A port of this machine that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
