"""Executes the suite's graph of runs by dask.distributed: several runs at once, on this machine or on a cluster.

Runs are tasks, keyed by their digests; a task waits for the tasks of its inputs. The scheduler repeats a task whose
worker was killed, and computes each key once, however many jobs ask for it. A file lock prevents a worker that the
scheduler considers lost from making a run at the same time as the worker that replaces it.
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from distributed import Client, Future, LocalCluster, as_completed
from filelock import FileLock
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from ablations.study.missing import reason_of
from ablations.suite.descriptions import Experiment, read_experiment
from ablations.suite.method_runs import Runs
from ablations.suite.plan import PlannedRun, RunSpec, plan_runs
from gaussian_enhancer.configurations import configurations
from gaussian_enhancer.console import print_line
from gaussian_enhancer.cores import usable_cores
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.instantiate import plain_values
from gaussian_enhancer.runs.lock import wait_for_holders
from gaussian_enhancer.runs.runtime import choose_device

MAX_WORKERS = 4
"""Default limit on the number of workers: each needs two or three gigabytes."""


class StoppedRunError(Exception):
    """The user stopped a run in a worker."""


def make_runs_ahead(cfg: DictConfig, experiments: Sequence[Experiment], console: Console) -> dict[str, Exception]:
    """Make the missing runs that tables need. Cost measurements are left out: they need an otherwise idle machine.

    Args:
        cfg: conf/tables.yaml, composed.
        experiments: the tables.
        console: prints a line when a run ends.

    Returns:
        The error of each failed run, by digest. Runs that need a failed run are not started.

    Raises:
        InputError: the number of workers is not positive, or no scheduler answers at the address.
        KeyboardInterrupt: the user stopped a run.
    """
    workers = worker_count(cfg)
    if workers == 1 and not cfg.scheduler:
        return {}
    steps = runnable(plan_runs(cfg, experiments))
    if not steps:
        return {}
    cfg = cfg.copy()
    cfg.runtime.progress = False
    if not cfg.scheduler:
        cfg.runtime.threads = max(1, usable_cores() // workers)
    with _client(cfg, workers) as client:
        futures = submit_runs(client, steps, plain_values(cfg))
        for count, future in enumerate(as_completed(list(futures.values())), 1):
            step = next(planned_run for planned_run in steps if futures[planned_run.name].key == future.key)
            error = future.exception() if _failed_itself(future, step, futures) else None
            if isinstance(error, StoppedRunError):
                raise KeyboardInterrupt
            message = f"{count} of {len(steps)}: {step.work.job} {step.name}"
            message += f": {reason_of(error)}" if error else "" if future.status == "finished" else ": an input failed"
            print_line(console, message)
        failed = [
            planned_run for planned_run in steps if _failed_itself(futures[planned_run.name], planned_run, futures)
        ]
        return {planned_run.digest: futures[planned_run.name].exception() for planned_run in failed}


def runnable(steps: Sequence[PlannedRun]) -> list[PlannedRun]:
    """The runs that can be made ahead: unfinished, no cost measurements, composable together with their inputs."""
    runnable_steps: dict[str, PlannedRun] = {}
    blocked: set[str] = set()
    for step in steps:
        if step.state.name == "done" or step.work.job == "cost":
            continue
        if not step.digest or not blocked.isdisjoint(step.inputs):
            blocked.add(step.name)
        else:
            runnable_steps[step.name] = step
    return list(runnable_steps.values())


def submit_runs(client: Client, steps: Sequence[PlannedRun], settings: dict[str, Any]) -> dict[str, Future]:
    """Submit a task for every run; it waits for its inputs. Among runnable tasks, the longest has priority."""
    futures: dict[str, Future] = {}
    for step in steps:  # a run's inputs precede it in the list
        inputs = [futures[name] for name in step.inputs if name in futures]
        key, priority = f"{step.work.job}-{step.digest}", round(step.minutes * 60)
        futures[step.name] = client.submit(
            _make, settings, step.work, step.digest, inputs, key=key, priority=priority, pure=False
        )
    return futures


def worker_count(cfg: DictConfig) -> int:
    """The number of runs that are made at once on this machine.

    Raises:
        InputError: the number is not positive.
    """
    if cfg.workers is None:
        on_gpu = choose_device(cfg.runtime.device).type == "cuda"
        return 1 if on_gpu else min(MAX_WORKERS, usable_cores())
    if not isinstance(cfg.workers, int) or cfg.workers < 1:
        raise InputError("workers", f"is {cfg.workers!r}", "give a positive number or null")
    return int(cfg.workers)


def _client(cfg: DictConfig, workers: int) -> Client:
    """A client of the scheduler at the user's address, or of a new cluster of processes on this machine."""
    if not cfg.scheduler:
        logging.getLogger("distributed").setLevel(logging.WARNING)  # not each start and end of a connection
        options = {"threads_per_worker": 1, "processes": True, "memory_limit": 0, "dashboard_address": None}
        return _LocalClient(LocalCluster(n_workers=workers, **options))
    try:
        return Client(str(cfg.scheduler), timeout=10)
    except OSError as error:
        raise InputError("scheduler", f"does not answer at {cfg.scheduler}", "start it: dask scheduler") from error


class _LocalClient(Client):
    """A client that closes its local cluster on exit."""

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self.cluster.close()


def _failed_itself(future: Future, step: PlannedRun, futures: dict[str, Future]) -> bool:
    """Whether a run failed itself, rather than because one of its inputs failed."""
    input_futures = [futures[name] for name in step.inputs if name in futures]
    return future.status == "error" and all(input_future.status != "error" for input_future in input_futures)


def _make(settings: dict[str, Any], work: RunSpec, digest: str, inputs: Sequence[None]) -> None:
    """Make one run in a worker. ``inputs`` only make dask wait for the runs that it needs."""
    from hydra import initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra

    cfg = OmegaConf.create(settings)
    locks = Path(cfg.runs) / "locks"
    locks.mkdir(parents=True, exist_ok=True)
    runs, table_experiment = Runs(cfg), read_experiment(work.table, cfg.scale)
    GlobalHydra.instance().clear()
    hydra_context = initialize_config_dir(str(configurations()), version_base="1.3")
    with FileLock(locks / f"{work.job}-{digest}"), hydra_context, wait_for_holders():
        try:
            if work.job == "fit":
                runs.make_fit(work.fit)
            elif work.job == "train_generator" and work.seed is not None:
                runs.simulator(work.seed)
            elif work.job == "train":
                runs.weights(table_experiment, work.method, work.seed)
            elif work.cell is not None:
                runs.make(table_experiment, work.cell, work.method, work.seed)
        except KeyboardInterrupt as error:
            raise StoppedRunError(str(error)) from error
