"""The plan of runs that tables need: each run once, with its inputs, state, estimated time and missing inputs."""

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
from gaussian_enhancer.cli.train import naming_configuration
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import matching_paths
from gaussian_enhancer.runs.run import find_run, run_digest
from gaussian_enhancer.runs.status import NAMES, State, state_of
from gaussian_enhancer.train.trainer import result_configuration

JOBS = ("fit", "train_generator", "train", "row", "cost")
"""Kinds of runs, in the order in which they are executed."""


@dataclass(frozen=True)
class RunSpec:
    """A description of one run that can be pickled and sent to a worker process.

    Args:
        job: "fit", "train_generator", "train", "row" (enhance and measure) or "cost".
        table: name of a table that needs the run.
        fit: overrides of a fit.
        method: name of the method that is trained or measured.
        seed: training seed; None for a method without training.
        cell: the study cell in which the method is measured.
    """

    job: str
    table: str
    fit: tuple[str, ...] = ()
    method: str = ""
    seed: int | None = None
    cell: StudyCell | None = None


@dataclass(frozen=True)
class PlannedRun:
    """One run of the plan.

    Args:
        work: how to make the run.
        digest: digest of its configuration; empty if the configuration cannot be composed yet.
        name: label and digest; the label alone if there is no digest.
        state: not started, running, stopped, failed or done.
        inputs: names of the runs that must finish first.
        minutes: estimated time; 0 for a finished run.
        missing: missing inputs that no run produces, such as a dataset; empty if there are none.
        tables: names of the tables that need the run.
    """

    work: RunSpec
    digest: str
    name: str
    state: State
    inputs: tuple[str, ...]
    minutes: float
    missing: str
    tables: tuple[str, ...]


def plan_runs(cfg: DictConfig, experiments: Sequence[Experiment]) -> list[PlannedRun]:
    """List every run that tables need, each once; a run's inputs come before it.

    Nothing is computed or written.

    Args:
        cfg: conf/tables.yaml or conf/status.yaml, composed.
        experiments: the tables.
    """
    plan = _Plan(cfg, {metric for experiment in experiments for metric in experiment.table.metrics})
    for experiment in experiments:
        if experiment.table.kind == "cost":
            plan.costs(experiment)
        for cell in experiment.cells:
            for method in experiment.table.methods:
                for seed in experiment.seeds(method):
                    plan.method(experiment, cell, method, seed)
    return plan.steps()


def format_plan(steps: Sequence[PlannedRun]) -> str:
    """Format a plan as text: one line per run, then the totals."""
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
    """Collects the planned runs by digest."""

    def __init__(self, cfg: DictConfig, metrics: Set[str]) -> None:
        self.cfg, self.runs, self.metrics = cfg, Runs(cfg), metrics
        self.estimates = Estimates(Path(cfg.runs), cfg.scale)
        self.runs_by_digest: dict[str, PlannedRun] = {}
        self.tables: dict[str, dict[str, None]] = {}
        self.digests: dict[tuple[Any, ...], str] = {}

    def steps(self) -> list[PlannedRun]:
        """All planned runs, each with the tables that need it."""
        return [replace(step, tables=tuple(self.tables[key])) for key, step in self.runs_by_digest.items()]

    def method(self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None) -> None:
        """Add a method in a cell, after its fit and training."""
        label = f"{cell.scene}-{cell.splat}-{method}" + ("" if seed is None else f"-seed{seed}")
        inputs = [self.fit(experiment, cell.fit)]
        if seed is not None:
            inputs.append(self.training(experiment, method, seed))
        work = RunSpec("row", experiment.table.name, method=method, seed=seed, cell=cell)
        self._add(work, label, lambda: self.runs.row_job(experiment, cell, method, seed), inputs)

    def costs(self, experiment: Experiment) -> None:
        """Add the trainings of all methods, then a cost measurement for each output size."""
        seed = experiment.table.seeds[0]
        inputs = [self.training(experiment, method, seed) for method in experiment.table.methods]

        def job(size: str) -> DictConfig:
            training_digests = {
                method: self.runs.train_digest(experiment, method, seed) for method in experiment.table.methods
            }
            height, width = self.cfg.scale.outputs[size]
            return cost_job(self.runs, training_digests, size, (int(height), int(width)))

        for size in experiment.table.datasets:
            self._add(RunSpec("cost", experiment.table.name), size, partial(job, size), inputs)

    def training(self, experiment: Experiment, method: str, seed: int) -> str:
        """Add the training of a method after its fits and its simulator; returns the training's name."""
        inputs = self.fits(experiment, experiment.learns[method])
        work = RunSpec("train", experiment.table.name, method=method, seed=seed)
        if self._uses_seed_simulator(experiment, method, seed):
            inputs.append(self.simulator(experiment, seed))
        configured, key = partial(self.runs.train_job, experiment, method, seed), train_key(experiment, method, seed)
        return self._add(work, f"seed{seed}", lambda: naming_configuration(configured()), inputs, key)

    def simulator(self, experiment: Experiment, seed: int) -> str:
        """Add the training of a seed's simulator after its fits; returns the training's name."""
        inputs = self.fits(experiment, str(self.cfg.scale.simulator.learns))
        work, key = RunSpec("train_generator", experiment.table.name, seed=seed), ("train_generator", seed)
        return self._add(work, f"seed{seed}", lambda: result_configuration(self.runs.simulator_job(seed)), inputs, key)

    def _uses_seed_simulator(self, experiment: Experiment, method: str, seed: int) -> bool:
        """Whether a training uses the simulator of its own seed; False if its configuration cannot be composed yet."""
        if self.cfg.scale.get("simulator") is None:
            return False
        try:
            return self.runs.uses_seed_simulator(self.runs.train_job(experiment, method, seed))
        except InputError:
            return False

    def fits(self, experiment: Experiment, training: str) -> list[str]:
        """Add the fits of one of the scale's trainings; returns their names."""
        return [self.fit(experiment, overrides) for side in self.runs.pairs(training).values() for overrides in side]

    def fit(self, experiment: Experiment, overrides: Sequence[str]) -> str:
        """Add a fit; returns its name."""
        label = "-".join(
            word.split("=")[1] for word in overrides if word.startswith(("scene=", "scene.seed=", "splat="))
        )
        work = RunSpec("fit", experiment.table.name, fit=tuple(overrides))
        configured = partial(self.runs.fit_job, overrides)
        return self._add(work, label.replace("/", "_"), configured, (), ("fit", *overrides))

    def _add(
        self,
        work: RunSpec,
        label: str,
        configured: Callable[[], DictConfig],
        inputs: Sequence[str],
        key: tuple[Any, ...] = (),
    ) -> str:
        """Add a run unless it is already planned; returns its name.

        Args:
            work: how to make the run.
            label: readable part of its name; the label of a training's configuration is put before it.
            configured: composes its configuration.
            inputs: names of the runs that must finish first.
            key: identifies the run without composing its configuration; empty if only the digest does.
        """
        digest = self.digests.get(key)
        if digest is None:
            digest = self._step(work, label, configured, tuple(inputs), key)
            self.digests |= {key: digest} if key else {}
        self.tables.setdefault(digest, {})[work.table] = None
        return self.runs_by_digest[digest].name

    def _step(
        self,
        work: RunSpec,
        label: str,
        configured: Callable[[], DictConfig],
        inputs: tuple[str, ...],
        key: Sequence[Any],
    ) -> str:
        """Plan a run from its configuration; returns its digest, or a text in its place if composing failed."""
        job, finer = work.job, work.cell is not None and work.cell.finer
        try:
            cfg = configured()
        except InputError as error:
            digest = f"{job} {label} {error}"
            minutes = self.estimates.minutes_without_config(job, key, finer)
            step = PlannedRun(work, "", label, State("not started"), inputs, minutes, str(error), ())
        else:
            digest = run_digest(cfg, job)
            run = find_run(cfg, job)
            state = state_of(None if run is None else run.folder)
            done = state.name == "done"
            minutes = 0.0 if done else self.estimates.minutes(job, cfg, finer)
            label = f"{cfg.label}-{label}" if job.startswith("train") else label
            name = f"{label}-{digest}" if run is None else run.folder.name
            missing = "" if done else _describe_missing_inputs(job, cfg, self.metrics)
            step = PlannedRun(work, digest, name, state, inputs, minutes, missing, ())
        self.runs_by_digest.setdefault(digest, step)
        return digest


def _describe_missing_inputs(job: str, cfg: DictConfig, metrics: Set[str]) -> str:
    """Describe the missing inputs of a run that no run produces; empty if there are none."""
    try:
        return ", ".join(_missing_inputs_of(job, cfg, metrics))
    except InputError as error:
        return str(error)


def _missing_inputs_of(job: str, cfg: DictConfig, metrics: Set[str]) -> Iterator[str]:
    """Missing inputs that no run produces: a dataset, gates, a device, the backbone of a metric."""
    import torch

    if job == "fit":
        yield from (f"{path} does not exist; {remedy}" for path, remedy in missing_inputs(cfg.scene))
    if job.startswith("train"):
        gates = (cfg.get("gate") or {}).get("file")
        for pattern in [gates] if isinstance(gates, str) else gates or ():
            if not any(path.exists() for path in matching_paths(pattern)):
                yield f"no gate at {pattern}; make them with: nox -s simulator"
        if cfg.trainer.accelerator == "cuda" and not torch.cuda.is_available():
            yield "torch finds no CUDA device"
    if job == "row":
        yield from (
            f"{name}: no backbone" for name, has_backbone in cfg.lpips.items() if name in metrics and not has_backbone
        )
