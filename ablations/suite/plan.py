"""What tables need: every run once, with its inputs, its state, what it is likely to cost and what it lacks."""

from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from ablations.suite.costs import cost_job
from ablations.suite.descriptions import Experiment
from ablations.suite.evaluation import StudyCell
from ablations.suite.inputs import missing_inputs
from ablations.suite.method_runs import Runs, train_key
from ablations.suite.time_estimates import Estimates
from gaussian_enhancer.cli.train import with_effect
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.run import find_run, run_digest
from gaussian_enhancer.runs.status import NAMES, State, state_of
from gaussian_enhancer.train.trainer import alike

JOBS = ("fit", "train_generator", "train", "row", "cost")
"""Kinds of runs, in the order in which they are made."""


@dataclass(frozen=True)
class Work:
    """What makes a run, as words that another process understands.

    Args:
        job: "fit", "train_generator", "train", "row" (enhanced and measured) or "cost".
        table: who needs it.
        fit: overrides of a fit.
        method: of a training, or of what is measured.
        seed: of its training; None where it learns nothing.
        cell: where it is measured.
    """

    job: str
    table: str
    fit: tuple[str, ...] = ()
    method: str = ""
    seed: int | None = None
    cell: StudyCell | None = None


@dataclass(frozen=True)
class PlannedRun:
    """One run.

    Args:
        work: what makes it.
        digest: its own; empty where its configuration cannot be had yet.
        name: its label and digest.
        state: not started, running, stopped, failed or done.
        inputs: the runs that come before it.
        minutes: what it is likely to cost; 0 where it is done.
        missing: what it lacks that no run makes; empty where it lacks nothing.
        tables: those that need it.
    """

    work: Work
    digest: str
    name: str
    state: State
    inputs: tuple[str, ...]
    minutes: float
    missing: str
    tables: tuple[str, ...]


def planned(cfg: DictConfig, experiments: Sequence[Experiment]) -> list[PlannedRun]:
    """Every run that tables need, each once, those that others need before them.

    Nothing is computed and nothing written.

    Args:
        cfg: conf/tables.yaml or conf/status.yaml, composed.
        experiments: the tables.
    """
    plan = _Plan(cfg, {metric for one in experiments for metric in one.table.metrics})
    for one in experiments:
        if one.table.kind == "cost":
            plan.costs(one)
        for cell in one.cells:
            for method in one.table.methods:
                for seed in one.seeds(method):
                    plan.method(one, cell, method, seed)
    return plan.steps()


def told(steps: Sequence[PlannedRun]) -> str:
    """A plan in words: a line a run, then the sums."""
    lines = []
    for step in steps:
        state = f"{step.state.name}: {step.state.detail}" if step.state.detail else step.state.name
        parts = [f"{step.work.job:<6} {step.name}", state, "" if not step.minutes else f"about {step.minutes:.1f} min"]
        parts.append(f"for {', '.join(step.tables)}")
        parts.append("" if not step.inputs else f"from {', '.join(step.inputs)}")
        parts.append("" if not step.missing else f"MISSING: {step.missing}")
        lines.append("; ".join(part for part in parts if part))
    counts = {name: sum(step.state.name == name for step in steps) for name in NAMES}
    lines.append(f"{len(steps)} runs: " + ", ".join(f"{count} {name}" for name, count in counts.items() if count))
    minutes = {job: sum(step.minutes for step in steps if step.work.job == job) for job in JOBS}
    total = sum(minutes.values())
    shares = ", ".join(f"{job} {value:.0f}" for job, value in minutes.items() if value)
    lines.append(
        f"about {total:.0f} minutes to go ({total / 60:.1f} hours of one worker){': ' + shares if shares else ''}"
    )
    missing = sum(bool(step.missing) for step in steps)
    lines.append(f"{missing} runs lack something that no run makes" if missing else "nothing is missing")
    return "\n".join(lines)


class _Plan:
    """Collects steps by their digests."""

    def __init__(self, cfg: DictConfig, metrics: Set[str]) -> None:
        self.cfg, self.runs, self.metrics = cfg, Runs(cfg), metrics
        self.estimates = Estimates(Path(cfg.runs), cfg.scale)
        self.known: dict[str, PlannedRun] = {}
        self.tables: dict[str, dict[str, None]] = {}
        self.names: dict[tuple[Any, ...], str] = {}

    def steps(self) -> list[PlannedRun]:
        """All steps, with the tables that need them."""
        return [replace(one, tables=tuple(self.tables[key])) for key, one in self.known.items()]

    def method(self, one: Experiment, cell: StudyCell, method: str, seed: int | None) -> None:
        """A method in a cell, and what comes before it."""
        label = f"{cell.scene}-{cell.splat}-{method}" + ("" if seed is None else f"-seed{seed}")
        inputs = [self.fit(one, cell.fit)]
        if seed is not None:
            inputs.append(self.training(one, method, seed))
        work = Work("row", one.table.name, method=method, seed=seed, cell=cell)
        self._add(work, label, lambda: self.runs.row_job(one, cell, method, seed), tuple(inputs), cell.finer)

    def costs(self, one: Experiment) -> None:
        """The trainings of all methods, and a measurement of each size."""
        seed = one.table.seeds[0]
        inputs = tuple(self.training(one, method, seed) for method in one.table.methods)

        def job(size: str) -> DictConfig:
            learnt = {method: self.runs.train_digest(one, method, seed) for method in one.table.methods}
            height, width = self.cfg.scale.outputs[size]
            return cost_job(self.runs, learnt, size, (int(height), int(width)))

        for size in one.table.datasets:
            self._add(Work("cost", one.table.name), size, partial(job, size), inputs)

    def training(self, one: Experiment, method: str, seed: int) -> str:
        """The training of a method and the fits before it; its name."""
        inputs = self.fits(one, one.learns[method])
        work, key = Work("train", one.table.name, method=method, seed=seed), train_key(one, method, seed)
        if self._simulated(one, method, seed):
            inputs.append(self.simulator(one, seed))
        return self._add(
            work, f"seed{seed}", lambda: with_effect(self.runs.train_job(one, method, seed)), tuple(inputs), key=key
        )

    def simulator(self, one: Experiment, seed: int) -> str:
        """The training of a seed's simulator and the fits before it; its name."""
        inputs = self.fits(one, str(self.cfg.scale.simulator.learns))
        work, key = Work("train_generator", one.table.name, seed=seed), ("train_generator", seed)
        return self._add(work, f"seed{seed}", lambda: alike(self.runs.simulator_job(seed)), tuple(inputs), key=key)

    def _simulated(self, one: Experiment, method: str, seed: int) -> bool:
        """Whether a training learns from its seed's own simulator; False where its configuration cannot be had yet."""
        if self.cfg.scale.get("simulator") is None:
            return False
        try:
            return self.runs.own_simulator(self.runs.train_job(one, method, seed))
        except InputError:
            return False

    def fits(self, one: Experiment, training: str) -> list[str]:
        """The fits of one of the scale's trainings; their names."""
        return [self.fit(one, own) for side in self.runs.pairs(training).values() for own in side]

    def fit(self, one: Experiment, overrides: Sequence[str]) -> str:
        """A fit; its name."""
        label = "-".join(
            word.split("=")[1] for word in overrides if word.startswith(("scene=", "scene.seed=", "splat="))
        )
        work = Work("fit", one.table.name, fit=tuple(overrides))
        return self._add(
            work, label.replace("/", "_"), lambda: self.runs.fit_job(overrides), (), key=("fit", *overrides)
        )

    def _add(
        self,
        work: Work,
        label: str,
        configured: Callable[[], DictConfig],
        inputs: tuple[str, ...],
        finer: bool = False,
        key: tuple[Any, ...] | None = None,
    ) -> str:
        """A step, unless it is known; its name.

        Args:
            work: what makes it.
            label: a readable part of its name; trainings have one of their own.
            configured: gives its configuration.
            inputs: names of what comes before it.
            finer: whether it is about images 4 times as fine.
            key: tells it from others without composing it; None: its digest does.
        """
        if key is not None and key in self.names:
            self.tables[self.names[key]][work.table] = None
            return self.known[self.names[key]].name
        digest = self._step(work, label, configured, inputs, finer, key or ())
        if key is not None:
            self.names[key] = digest
        self.tables.setdefault(digest, {})[work.table] = None
        return self.known[digest].name

    def _step(
        self,
        work: Work,
        label: str,
        configured: Callable[[], DictConfig],
        inputs: tuple[str, ...],
        finer: bool,
        words: Sequence[Any],
    ) -> str:
        """A step by what its configuration says; its digest."""
        job, nothing = work.job, State("not started")
        try:
            cfg = configured()
        except InputError as error:
            digest = f"{job} {label} {error}"
            step = PlannedRun(work, "", label, nothing, inputs, self.estimates.blind(job, words, finer), str(error), ())
        else:
            digest = run_digest(cfg, job)
            found = find_run(cfg, job)
            state = state_of(None if found is None else found.folder)
            done = state.name == "done"
            minutes = 0.0 if done else self.estimates.minutes(job, cfg, finer)
            label = f"{cfg.label}-{label}" if job.startswith("train") else label
            name = f"{label}-{digest}" if found is None else found.folder.name
            lacks = "" if done else _lacks(job, cfg, self.metrics)
            step = PlannedRun(work, digest, name, state, inputs, minutes, lacks, ())
        self.known.setdefault(digest, step)
        return digest


def _lacks(job: str, cfg: DictConfig, metrics: Set[str]) -> str:
    """What a run needs for metrics and no run makes, in words; empty where it lacks nothing."""
    try:
        return ", ".join(_lacking(job, cfg, metrics))
    except InputError as error:
        return str(error)


def _lacking(job: str, cfg: DictConfig, metrics: Set[str]) -> Iterator[str]:
    """What a run needs and no run makes: a dataset, gates, a device, a metric's backbone."""
    import glob

    import torch

    if job == "fit":
        yield from (f"{path} does not exist; {remedy}" for path, remedy in missing_inputs(cfg.scene))
    if job.startswith("train"):
        gates = (cfg.get("gate") or {}).get("file")
        for pattern in [gates] if isinstance(gates, str) else gates or ():
            if not glob.glob(pattern):
                yield f"no gate at {pattern}; make them with: nox -s simulator"
        if cfg.trainer.accelerator == "cuda" and not torch.cuda.is_available():
            yield "torch finds no CUDA device"
    if job == "row":
        yield from (f"{name}: no backbone" for name, there in cfg.lpips.items() if name in metrics and not there)
