"""The suite's graph of runs on dask.distributed: several runs at once, on this machine or on a cluster.

Runs are tasks, keyed by their digests; a task waits for those of its inputs. The scheduler makes a task again when its
worker is killed, and computes one key once however many jobs ask for it. A lock beside the runs keeps a worker that the
scheduler has given up from making a run beside its successor.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from distributed import Client, Future, LocalCluster, as_completed
from filelock import FileLock
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from ablations.suite.descriptions import Experiment, experiment
from ablations.suite.method_runs import Runs
from ablations.suite.plan import PlannedRun, Work, planned
from gaussian_enhancer.cli.main import configurations
from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import InputError, reason_of
from gaussian_enhancer.runs.instantiate import plain
from gaussian_enhancer.runs.lock import waiting
from gaussian_enhancer.runs.runtime import choose_device

MOST = 4
"""Workers, where nothing else is said: each needs two or three gigabytes."""


class StoppedRunError(Exception):
    """The user stopped a run in a worker."""


def made_ahead(cfg: DictConfig, experiments: Sequence[Experiment], console: Console) -> dict[str, Exception]:
    """Make the runs that tables need and that are missing, but for times, which want a quiet machine.

    Args:
        cfg: conf/tables.yaml, composed.
        experiments: the tables.
        console: is told of every run that ends.

    Returns:
        What went wrong, by the run's digest. Runs that need one of these are left alone.

    Raises:
        InputError: the number of workers is not positive, or there is no scheduler at the address.
        KeyboardInterrupt: the user stopped a run.
    """
    workers = worker_count(cfg)
    if workers == 1 and not cfg.scheduler:
        return {}
    steps = runnable(planned(cfg, experiments))
    if not steps:
        return {}
    cfg = cfg.copy()
    cfg.runtime.progress = False
    if not cfg.scheduler:
        cfg.runtime.threads = max(1, len(os.sched_getaffinity(0)) // workers)
    with _client(cfg, workers) as client:
        futures = submitted(client, steps, plain(cfg))
        for count, future in enumerate(as_completed(list(futures.values())), 1):
            step = next(one for one in steps if futures[one.name].key == future.key)
            error = future.exception() if _own_error(future, step, futures) else None
            if isinstance(error, StoppedRunError):
                raise KeyboardInterrupt
            words = f"{count} of {len(steps)}: {step.work.job} {step.name}"
            words += f": {reason_of(error)}" if error else "" if future.status == "finished" else ": an input failed"
            print_line(console, words)
        failed = [one for one in steps if _own_error(futures[one.name], one, futures)]
        return {one.digest: futures[one.name].exception() for one in failed}


def runnable(steps: Sequence[PlannedRun]) -> list[PlannedRun]:
    """The steps that can be made ahead: not done, no times, and neither they nor their inputs lack a configuration."""
    known: dict[str, PlannedRun] = {}
    blocked: set[str] = set()
    for step in steps:
        if step.state.name == "done" or step.work.job == "cost":
            continue
        if not step.digest or not blocked.isdisjoint(step.inputs):
            blocked.add(step.name)
        else:
            known[step.name] = step
    return list(known.values())


def submitted(client: Client, steps: Sequence[PlannedRun], settings: dict[str, Any]) -> dict[str, Future]:
    """A task for every step, after those of its inputs; the longest of those that can be made comes first."""
    futures: dict[str, Future] = {}
    for step in steps:  # a step's inputs stand before it
        inputs = [futures[name] for name in step.inputs if name in futures]
        key, priority = f"{step.work.job}-{step.digest}", round(step.minutes * 60)
        futures[step.name] = client.submit(
            _make, settings, step.work, step.digest, inputs, key=key, priority=priority, pure=False
        )
    return futures


def worker_count(cfg: DictConfig) -> int:
    """How many runs are made at once on this machine.

    Raises:
        InputError: the number is not positive.
    """
    if cfg.workers is None:
        on_gpu = choose_device(cfg.runtime.device).type == "cuda"
        return 1 if on_gpu else min(MOST, len(os.sched_getaffinity(0)))
    if not isinstance(cfg.workers, int) or cfg.workers < 1:
        raise InputError("workers", f"is {cfg.workers!r}", "give a positive number or null")
    return int(cfg.workers)


def _client(cfg: DictConfig, workers: int) -> Client:
    """A client of the scheduler that the user names, or of a cluster of processes on this machine."""
    if not cfg.scheduler:
        options = {"threads_per_worker": 1, "processes": True, "memory_limit": 0, "dashboard_address": None}
        return _LocalClient(LocalCluster(n_workers=workers, **options))
    try:
        return Client(str(cfg.scheduler), timeout=10)
    except OSError as error:
        raise InputError("scheduler", f"does not answer at {cfg.scheduler}", "start it: dask scheduler") from error


class _LocalClient(Client):
    """A client that closes its own cluster."""

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self.cluster.close()


def _own_error(future: Future, step: PlannedRun, futures: dict[str, Future]) -> bool:
    """Whether a run failed by itself, and not because one of its inputs did."""
    before = [futures[name] for name in step.inputs if name in futures]
    return future.status == "error" and all(one.status != "error" for one in before)


def _make(settings: dict[str, Any], work: Work, digest: str, inputs: Sequence[None]) -> None:
    """Make one run, in a worker; ``inputs`` are the runs before it, which dask waits for."""
    from hydra import initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra

    cfg = OmegaConf.create(settings)
    locks = Path(cfg.runs) / "locks"
    locks.mkdir(parents=True, exist_ok=True)
    runs, one = Runs(cfg), experiment(work.table, cfg.scale)
    GlobalHydra.instance().clear()
    composing = initialize_config_dir(str(configurations()), version_base="1.3")
    with FileLock(locks / f"{work.job}-{digest}"), composing, waiting():
        try:
            if work.job == "fit":
                runs.fitted(work.fit)
            elif work.job == "train_generator" and work.seed is not None:
                runs.simulator(work.seed)
            elif work.job == "train":
                runs.weights(one, work.method, work.seed)
            elif work.cell is not None:
                runs.make(one, work.cell, work.method, work.seed)
        except KeyboardInterrupt as error:
            raise StoppedRunError(str(error)) from error
