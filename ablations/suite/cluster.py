"""Runs of a suite made ahead of their tables, several at once: each by one process with its share of the cores.

Two trainings on a core each take less time than one after the other on two. The calling process alone decides what is
made next, so that no run is made twice.
"""

import os
import threading
import time
from collections.abc import Sequence, Set
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import get_context
from typing import Any

from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from ablations.suite.descriptions import Experiment, experiment
from ablations.suite.method_runs import Runs
from ablations.suite.plan import Step, Work, planned
from gaussian_enhancer.cli.main import configurations
from gaussian_enhancer.errors import InputError, reason_of
from gaussian_enhancer.runs.instantiate import plain
from gaussian_enhancer.runs.runtime import choose_device

MOST = 4
"""Workers, where nothing else is said: each needs two or three gigabytes."""


def made_ahead(cfg: DictConfig, experiments: Sequence[Experiment], console: Console) -> dict[str, Exception]:
    """Make the runs that tables need and that are missing, but for times, which want a quiet machine.

    Args:
        cfg: conf/tables.yaml, composed.
        experiments: the tables.
        console: is told of every run that ends.

    Returns:
        what went wrong, by the run's digest. Runs that need one of these are left alone.

    Raises:
        InputError: the number of workers is not positive.
        KeyboardInterrupt: the user stopped a run.
    """
    workers = worker_count(cfg)
    if workers == 1:
        return {}
    steps = [one for one in planned(cfg, experiments) if one.work.job != "cost" and one.state.name != "done"]
    cfg = cfg.copy()
    cfg.runtime.threads = max(1, len(os.sched_getaffinity(0)) // workers)
    cfg.runtime.progress = False
    settings = plain(cfg)
    failures: dict[str, Exception] = {}
    waiting, running, failed, total = list(steps), dict[Future[None], Step](), set[str](), len(steps)
    pool = ProcessPoolExecutor(workers, get_context("spawn"), _watch, (os.getpid(),))
    with pool, suppress(BrokenProcessPool):  # a worker was killed: what is left is made one by one
        while waiting or running:
            _start(pool, settings, waiting, running, failed, workers)
            if not running:
                break  # the rest needs what failed
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                step, error = running.pop(future), future.exception()
                ended = f"{total - len(waiting) - len(running)} of {total}: {step.work.job} {step.name}"
                told = ended if error is None else f"{ended}: {reason_of(error)}"
                console.print(told, highlight=False, soft_wrap=True)
                if error is None:
                    continue
                if isinstance(error, BrokenProcessPool) or not isinstance(error, Exception):
                    raise error
                failed.add(step.name)
                failures[step.digest] = error
    return failures


def worker_count(cfg: DictConfig) -> int:
    """How many runs are made at once.

    Raises:
        InputError: the number is not positive.
    """
    if cfg.workers is None:
        on_gpu = choose_device(cfg.runtime.device).type == "cuda"
        return 1 if on_gpu else min(MOST, len(os.sched_getaffinity(0)))
    if not isinstance(cfg.workers, int) or cfg.workers < 1:
        raise InputError("workers", f"is {cfg.workers!r}", "give a positive number or null")
    return int(cfg.workers)


def next_step(waiting: Sequence[Step], unmade: Set[str]) -> Step | None:
    """The longest of the runs that can be made now; None where there is none.

    Args:
        waiting: runs to be made.
        unmade: names of the runs that are not there: those that wait, are being made, or failed.
    """
    ready = [one for one in waiting if one.digest and unmade.isdisjoint(one.inputs)]
    return max(ready, key=lambda one: one.minutes, default=None)


def _start(
    pool: ProcessPoolExecutor,
    settings: dict[str, Any],
    waiting: list[Step],
    running: dict[Future[None], Step],
    failed: set[str],
    workers: int,
) -> None:
    """Begin as many runs as there are free workers."""
    while len(running) < workers:
        step = next_step(waiting, {one.name for one in (*waiting, *running.values())} | failed)
        if step is None:
            return
        waiting.remove(step)
        running[pool.submit(_make, settings, step.work)] = step


def _make(settings: dict[str, Any], work: Work) -> None:
    """Make one run, in a worker."""
    from hydra import initialize_config_dir

    cfg = OmegaConf.create(settings)
    runs, one = Runs(cfg), experiment(work.table, cfg.scale)
    with initialize_config_dir(str(configurations()), version_base="1.3"):
        if work.job == "fit":
            runs.fitted(work.fit)
        elif work.job == "train":
            runs.weights(one, work.method, work.seed)
        elif work.cell is not None:
            runs.make(one, work.cell, work.method, work.seed)


def _watch(parent: int) -> None:
    """End a worker whose parent was killed: what it makes would be made twice."""

    def look() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=look, daemon=True).start()
