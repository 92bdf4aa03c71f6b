"""The plan of runs that tables need: each run once, with its inputs, state, estimated time and what it lacks itself."""

from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from ablations.suite.costs import cost_job
from ablations.suite.descriptions import Experiment
from ablations.suite.evaluation import StudyCell
from ablations.suite.inputs import describe_missing, held_out_views, unset_variable
from ablations.suite.method_runs import Runs, train_key
from ablations.suite.time_estimates import Estimates
from gaussian_enhancer.cli.train import naming_configuration
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import matching_paths
from gaussian_enhancer.runs.compose import compose_job
from gaussian_enhancer.runs.high_resolution import high_resolution_config
from gaussian_enhancer.runs.run import find_run, run_digest
from gaussian_enhancer.runs.status import State, state_of
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
class TableCell:
    """A part of a table: all scenes of one dataset, fitted by one splatting method.

    Args:
        table: name of the table.
        dataset: title of the dataset; the output's size in a table of costs.
        splat: the splatting method; empty in a table of costs.
    """

    table: str
    dataset: str
    splat: str = ""

    def __str__(self) -> str:
        """The three names, joined."""
        return ", ".join(name for name in (self.table, self.dataset, self.splat) if name)


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
        missing: what it lacks itself and no run produces, such as a dataset; empty if there is nothing.
        tables: names of the tables that need the run.
        without: metrics that the run cannot measure, and why; empty if it measures all.
        cells: parts of tables that show the run's records.
    """

    work: RunSpec
    digest: str
    name: str
    state: State
    inputs: tuple[str, ...]
    minutes: float
    missing: str
    tables: tuple[str, ...]
    without: str = ""
    cells: tuple[TableCell, ...] = ()


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


class _Plan:
    """Collects the planned runs by digest."""

    def __init__(self, cfg: DictConfig, metrics: Set[str]) -> None:
        self.cfg, self.runs, self.metrics = cfg, Runs(cfg), metrics
        self.estimates = Estimates(Path(cfg.runs), cfg.scale)
        self.runs_by_digest: dict[str, PlannedRun] = {}
        self.tables: dict[str, dict[str, None]] = {}
        self.cells: dict[str, dict[TableCell, None]] = {}
        self.digests: dict[tuple[Any, ...], str] = {}
        self.nameless: set[str] = set()
        self.scenes: dict[str, tuple[str, ...]] = {}
        self.views: dict[tuple[str, ...], int | None] = {}

    def steps(self) -> list[PlannedRun]:
        """All planned runs, each with the tables that need it and the cells that show it."""
        return [
            replace(step, tables=tuple(self.tables[key]), cells=tuple(self.cells.get(key, ())))
            for key, step in self.runs_by_digest.items()
        ]

    def method(self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None) -> None:
        """Add a method in a cell, after its fit and training."""
        label = f"{cell.scene}-{cell.splat}-{method}" + ("" if seed is None else f"-seed{seed}")
        inputs = [self.fit(experiment, cell.fit)]
        if seed is not None:
            inputs.append(self.training(experiment, method, seed))
        work = RunSpec("row", experiment.table.name, method=method, seed=seed, cell=cell)
        dataset = next(group.title for group in experiment.table.datasets.values() if cell.scene in group.scenes)
        shown = TableCell(experiment.table.name, dataset, cell.splat)
        self._add(work, label, lambda: self.runs.row_job(experiment, cell, method, seed), inputs, cell=shown)

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

        for size, group in experiment.table.datasets.items():
            shown = TableCell(experiment.table.name, group.title)
            self._add(RunSpec("cost", experiment.table.name), size, partial(job, size), inputs, cell=shown)

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
        cell: TableCell | None = None,
    ) -> str:
        """Add a run unless it is already planned; returns its name.

        Args:
            work: how to make the run.
            label: readable part of its name; the label of a training's configuration is put before it.
            configured: composes its configuration.
            inputs: names of the runs that must finish first.
            key: identifies the run without composing its configuration; empty if only the digest does.
            cell: the part of a table that shows the run's records; None if none does.
        """
        digest = self.digests.get(key)
        if digest is None:
            digest = self._step(work, label, configured, tuple(inputs), key)
            self.digests |= {key: digest} if key else {}
        self.tables.setdefault(digest, {})[work.table] = None
        if cell is not None:
            self.cells.setdefault(digest, {})[cell] = None
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
        try:
            cfg = configured()
        except InputError as error:
            digest, step = self._step_without_config(work, label, inputs, key, error)
            self.nameless.add(step.name)
        else:
            digest = run_digest(cfg, work.job)
            step = self._configured_step(work, label, cfg, digest, inputs)
        self.runs_by_digest.setdefault(digest, step)
        return digest

    def _configured_step(
        self, work: RunSpec, label: str, cfg: DictConfig, digest: str, inputs: tuple[str, ...]
    ) -> PlannedRun:
        job, run = work.job, find_run(cfg, work.job)
        state = state_of(None if run is None else run.folder)
        label = f"{cfg.label}-{label}" if job.startswith("train") else label
        name = f"{label}-{digest}" if run is None else run.folder.name
        if state.name == "done":
            return PlannedRun(work, digest, name, state, inputs, 0.0, "", ())
        finer, views = self._measured(work.cell)
        minutes = self.estimates.minutes(job, cfg, finer, views)
        missing = self._describe_missing_inputs(work, cfg)
        without = _unavailable_metrics(cfg, self.metrics) if job == "row" else ""
        return PlannedRun(work, digest, name, state, inputs, minutes, missing, (), without)

    def _step_without_config(
        self, work: RunSpec, label: str, inputs: tuple[str, ...], key: Sequence[Any], error: InputError
    ) -> tuple[str, PlannedRun]:
        """Plan a run whose configuration cannot be composed; returns a text in place of its digest, and the run."""
        fit = self._fit_with_unset_folder(work)
        if fit is not None:
            minutes, missing = self.estimates.minutes("fit", fit), ", ".join(describe_missing(fit.scene))
            name = f"{label}-1/{fit.scene.get('downscale', 1)}"
            return OmegaConf.to_yaml(fit), PlannedRun(
                work, "", name, State("not started"), inputs, minutes, missing, ()
            )
        finer, views = self._measured(work.cell)
        if work.cell is not None and views is not None:
            views = -(-views // work.cell.every)
        minutes = self.estimates.minutes_without_config(work.job, key, finer, views)
        missing = "" if self.nameless.intersection(inputs) else str(error)  # an input's error is not repeated
        step = PlannedRun(work, "", label, State("not started"), inputs, minutes, missing, ())
        return f"{work.job} {label} {work.fit} {work.cell} {error}", step

    def _fit_with_unset_folder(self, work: RunSpec) -> DictConfig | None:
        """Configuration of a fit whose scene lies in an unset environment variable's folder; None for other runs."""
        if work.job != "fit":
            return None
        try:
            job = compose_job("fit", self.cfg, work.fit)
        except InputError:
            return None
        return job if unset_variable(job.scene) else None

    def _scene(self, cell: StudyCell) -> DictConfig:
        """Configuration of a cell's scene; its folder may refer to an environment variable that is not set."""
        scene: DictConfig = compose_job("fit", self.cfg, cell.fit).scene
        return scene

    def _measured(self, cell: StudyCell | None) -> tuple[bool, int | None]:
        """Whether a cell is measured at 4 times the resolution, and its held-out views if its dataset states them."""
        return (False, None) if cell is None else (cell.finer, self._views(cell))

    def _views(self, cell: StudyCell) -> int | None:
        """Number of held-out views of a cell, if its dataset states it."""
        if cell.fit not in self.views:
            try:
                self.views[cell.fit] = held_out_views(self._scene(cell))
            except InputError:
                self.views[cell.fit] = None
        return self.views[cell.fit]

    def _describe_missing_inputs(self, work: RunSpec, cfg: DictConfig) -> str:
        """Describe the missing inputs of a run that no run produces; empty if there are none."""
        try:
            if work.job == "fit":
                return ", ".join(self._missing_of_scene(cfg.scene))
            if work.cell is not None and work.cell.finer:
                return ", ".join(self._missing_of_scene(high_resolution_config(self._scene(work.cell))))
            return ", ".join(_missing_for_training(cfg)) if work.job.startswith("train") else ""
        except InputError as error:
            return str(error)

    def _missing_of_scene(self, scene: DictConfig) -> tuple[str, ...]:
        """What a scene lacks; each scene is looked at once, since many runs need the same."""
        key = OmegaConf.to_yaml(scene, resolve=True)
        if key not in self.scenes:
            self.scenes[key] = describe_missing(scene)
        return self.scenes[key]


def _missing_for_training(cfg: DictConfig) -> Iterator[str]:
    """Missing inputs of a training that no run produces: gates, a device."""
    import torch

    gates = (cfg.get("gate") or {}).get("file")
    for pattern in [gates] if isinstance(gates, str) else gates or ():
        if not any(path.exists() for path in matching_paths(pattern)):
            yield f"no gate at {pattern}; make them with: nox -s simulator"
    if cfg.trainer.accelerator == "cuda" and not torch.cuda.is_available():
        yield "torch finds no CUDA device"


def _unavailable_metrics(cfg: DictConfig, metrics: Set[str]) -> str:
    """Metrics of a row that cannot be measured since their backbone is missing; the tables mark their values so."""
    absent = [name for name, has_backbone in cfg.lpips.items() if name in metrics and not has_backbone]
    return f"{', '.join(map(str, absent))}: no backbone" if absent else ""
