"""The runs behind a table's methods: their configurations and digests, and making missing ones.

The address of a run is the digest of everything that determines it, so it is known before the run is made. A training
depends on the digests of its fits; a method in a cell depends on those of its fit and its training. Equal methods of
different tables share one run.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import DictConfig, OmegaConf, open_dict

from ablations.suite.descriptions import Experiment
from ablations.suite.evaluation import StudyCell, compose_checked, measure_now, method_images
from gaussian_enhancer.checkpoint import WEIGHTS
from gaussian_enhancer.cli import train, train_generator
from gaussian_enhancer.cli.pipeline import fit_run
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_json
from gaussian_enhancer.metrics.image_folders import Label
from gaussian_enhancer.metrics.lpips import data_backbones, perceptual_distance
from gaussian_enhancer.metrics.pair import PROTOCOL
from gaussian_enhancer.metrics.records import Record, read_records, write_records
from gaussian_enhancer.runs import status
from gaussian_enhancer.runs.compose import compose_job
from gaussian_enhancer.runs.instantiate import require
from gaussian_enhancer.runs.run import Run, find_run, open_run, run_digest
from gaussian_enhancer.train.trainer import result_configuration

T = TypeVar("T")


def train_key(experiment: Experiment, method: str, seed: int) -> tuple[Any, ...]:
    """A key that identifies a method's training without composing its configuration."""
    return ("train", experiment.learns[method], *experiment.table.methods[method].train, seed)


def with_backbones(cfg: DictConfig) -> DictConfig:
    """Set ``backbones`` to the data folder's LPIPS backbones if it is null: digests of measured runs depend on it."""
    folder = data_backbones()
    if cfg.backbones is None and folder is not None:
        with open_dict(cfg):
            cfg.backbones = str(folder)
    return cfg


class Runs:
    """Finds, configures and makes the runs of the suite.

    Args:
        cfg: ``runs``, ``runtime``, ``scale``, ``backbones``, ``fit_missing``, ``train_missing``.
    """

    def __init__(self, cfg: DictConfig) -> None:
        self.cfg = cfg
        self.failures: dict[str, Exception] = {}
        self._measurable: dict[str, bool] | None = None
        self._digests: dict[tuple[Any, ...], str] = {}

    def fit_job(self, overrides: Sequence[str]) -> DictConfig:
        """Configuration of the job fit.

        Raises:
            InputError: the configuration is invalid, or refers to a value that is not set.
        """
        return compose_checked("fit", self.cfg, overrides)

    def fit_digest(self, overrides: Sequence[str]) -> str:
        """The digest of a fit."""
        return self._digest(("fit", *overrides), lambda: self.fit_job(overrides))

    def pairs(self, training: str) -> dict[str, list[tuple[str, ...]]]:
        """The fits that a training learns from, and those that it is validated on, as overrides of the job fit.

        Args:
            training: one of the scale's trainings.
        """
        scale = self.cfg.scale
        chosen = scale.trainings[training]
        sides = {"train": chosen.pairs, "validation": chosen.validation}
        return {
            side: [tuple(map(str, (*overrides, *scale.fit, *scale.sparse))) for overrides in fits]
            for side, fits in sides.items()
        }

    def train_job(self, experiment: Experiment, method: str, seed: int) -> DictConfig:
        """Configuration of the job train, on exactly the fits that the scale names; loggers group runs by table.

        Raises:
            InputError: the configuration is invalid, or a mandatory value is not set.
        """
        job = compose_job("train", self.cfg, [*experiment.table.methods[method].train, f"seed={seed}"])
        self._set_training_data(job, experiment.learns[method])
        job.study = experiment.table.name
        if self.uses_seed_simulator(job):
            simulator_job = self.simulator_job(seed)
            job.generator.weights = (
                f"{self.cfg.runs}/train_generator/{simulator_job.label}-{self.simulator_digest(seed)}/{WEIGHTS}"
            )
        require(job)
        return job

    def uses_seed_simulator(self, job: DictConfig) -> bool:
        """Whether a training uses a second stage of the simulator that the scale trains anew for each seed.

        Args:
            job: configuration of the job train.
        """
        has_simulator = self.cfg.scale.get("simulator") is not None
        return has_simulator and float(job.data.simulation.share) > 0 and bool(job.generator.get("weights"))

    def simulator_job(self, seed: int) -> DictConfig:
        """Configuration of the job train_generator for a seed, on the fits of one of the scale's trainings.

        Raises:
            InputError: the configuration is invalid, or a mandatory value is not set.
        """
        chosen = self.cfg.scale.simulator
        job = compose_job("train_generator", self.cfg, [*map(str, chosen.train), f"seed={seed}"])
        self._set_training_data(job, str(chosen.learns))
        require(job)
        return job

    def simulator_digest(self, seed: int) -> str:
        """The digest of the training of a seed's second stage."""
        return self._digest(("train_generator", seed), lambda: result_configuration(self.simulator_job(seed)))

    def simulator(self, seed: int) -> Run:
        """The second stage of a seed; if missing, its fits are made and it is trained now.

        Raises:
            InputError: it is missing and ``train_missing`` is false, or it cannot be trained.
            KeyboardInterrupt: the user stopped the training.
        """
        return self._call_once(self.simulator_digest(seed), lambda: self._simulator(seed))

    def _simulator(self, seed: int) -> Run:
        job = self.simulator_job(seed)
        run = find_run(result_configuration(job), "train_generator")
        if run is None or not run.done:
            if not self.cfg.train_missing:
                remedy = f"gaussian-enhancer tables scale={self.cfg.scale.name}"
                raise InputError(f"the simulator of seed {seed}", "is not trained yet", remedy)
            self._fit_all(str(self.cfg.scale.simulator.learns))
            with status.track_runs():
                train_generator.run(job)
            run = find_run(result_configuration(job), "train_generator")
        if run is None or not run.done:
            raise KeyboardInterrupt
        return run

    def _set_training_data(self, job: DictConfig, training: str) -> None:
        """Set a job's data to exactly the fits of one of the scale's trainings, and state this on its card."""
        for side, fits in self.pairs(training).items():
            job.data[side] = [f"{self.cfg.runs}/fit/*-{self.fit_digest(overrides)}" for overrides in fits]
        job.card = {"licence": "Apache-2.0", "data": f"Renders of the fits that scale {self.cfg.scale.name} names."}

    def train_digest(self, experiment: Experiment, method: str, seed: int) -> str:
        """The digest of a method's training."""
        key = train_key(experiment, method, seed)
        return self._digest(key, lambda: train.naming_configuration(self.train_job(experiment, method, seed)))

    def row_job(self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None) -> DictConfig:
        """Everything that determines a method's records in a cell; ``seed`` is None for a method without training."""
        choice = experiment.table.methods[method]
        training_digest = "" if seed is None else self.train_digest(experiment, method, seed)
        scene_keys = {"scene": cell.scene, "splat": cell.splat, "fit": self.fit_digest(cell.fit)}
        settings = {"enhance": list(choice.enhance), "upscale": choice.upscale, "render": choice.render}
        measurement = {
            "every": cell.every,
            "finer": cell.finer,
            "protocol": PROTOCOL,
            "lpips": self.available_distances(),
        }
        values = {**scene_keys, "train": training_digest, "weights": choice.weights, **settings, **measurement}
        return OmegaConf.create({"runs": self.cfg.runs, **values})

    def available_distances(self) -> dict[str, bool]:
        """The LPIPS distances of the scale, each with whether its backbone is available."""
        if self._measurable is None:
            distances = {str(name): perceptual_distance(name, self.cfg.backbones) for name in self.cfg.scale.lpips}
            self._measurable = {name: distance.network is not None for name, distance in distances.items()}
        return self._measurable

    def weights(self, experiment: Experiment, method: str, seed: int | None) -> str:
        """The weights of a method; if missing, its fits are made and it is trained now.

        Raises:
            InputError: they are missing and ``train_missing`` is false, or they cannot be trained.
            KeyboardInterrupt: the user stopped the training.
        """
        if seed is None:
            return experiment.table.methods[method].weights
        job = self.train_job(experiment, method, seed)
        run = find_run(train.naming_configuration(job), "train")
        if run is None or not run.done:
            if not self.cfg.train_missing:
                command = f"gaussian-enhancer tables table={experiment.table.name} scale={self.cfg.scale.name}"
                raise InputError(f"weights of {method}, seed {seed}", "are not trained yet", command)
            run = self._call_once(
                self.train_digest(experiment, method, seed), lambda: self._train_method(experiment, method, job)
            )
        return str(run.folder / WEIGHTS)

    def make(self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None) -> None:
        """Make a method's records in a cell, and all runs that they need, unless they exist.

        Raises:
            InputError: the method cannot be made here.
        """
        job = self.row_job(experiment, cell, method, seed)
        run = find_run(job, "row")
        if run is None or not run.done:
            self._call_once(run_digest(job, "row"), lambda: self._make_row(experiment, cell, method, seed, job))

    def records(self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None) -> tuple[Record, ...]:
        """Read a method's records in a cell, which `make` made.

        Raises:
            InputError: they are missing or damaged.
        """
        folder = self._row_folder(experiment, cell, method, seed)
        return tuple(replace(record, variant=method, seed=seed) for record in read_records(folder / "records.jsonl"))

    def images(self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None) -> tuple[Path, Path]:
        """The folders of a method's images in a cell and of their photos.

        Raises:
            InputError: they were not made.
        """
        file = self._row_folder(experiment, cell, method, seed) / "images.json"
        folders = json.loads(file.read_text(encoding="utf-8"))
        return Path(folders["images"]), Path(folders["photos"])

    def _row_folder(self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None) -> Path:
        run = find_run(self.row_job(experiment, cell, method, seed), "row")
        if run is None or not run.done:
            raise InputError(f"{method} in {cell.scene}, {cell.splat}", "is not measured yet", "make the table")
        return run.folder

    def _make_row(
        self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None, job: DictConfig
    ) -> None:
        choice = experiment.table.methods[method]
        with status.track_runs():
            row_run = open_run(job, "row", f"{cell.scene}-{cell.splat}-{method}")
            cell_fit = self._call_once(job.fit, partial(self.make_fit, cell.fit))
            weights = self.weights(experiment, method, seed)
            settings: dict[str, Any] = {"weights": weights, "enhance": list(choice.enhance)}
            settings |= {"upscale": choice.upscale, "render": choice.render}
            images = method_images(self.cfg, cell, method, OmegaConf.create(settings))
            label = Label(images.run, cell.scene, cell.splat, method)
            measure_cfg = OmegaConf.create({"lpips": list(self.available_distances()), "backbones": self.cfg.backbones})
            measure_cfg.runtime = self.cfg.runtime
            sources = {**images.sources, "fit": cell_fit.folder.name}
            if seed is not None:
                sources["train"] = Path(weights).parent.name
            records = [
                replace(record, seed=seed, sources=sources, weights=images.weights)
                for record in measure_now(measure_cfg, label, images)
            ]
            write_records(row_run.folder / "records.jsonl", records)
            folders = {"images": str(images.folder), "photos": str(images.photos)}
            write_json(row_run.folder / "images.json", folders)
            row_run.finish()

    def make_fit(self, overrides: Sequence[str]) -> Run:
        """A finished fit; made now if missing.

        Raises:
            InputError: it is missing and ``fit_missing`` is false, or it cannot be made.
        """
        refusal = InputError("the fit", "is not made yet", f"gaussian-enhancer fit {' '.join(overrides)}")
        return fit_run(self.fit_job(overrides), None if self.cfg.fit_missing else refusal)

    def _train_method(self, experiment: Experiment, method: str, job: DictConfig) -> Run:
        """Make a training's fits and simulator, then train; returns the finished training."""
        self._fit_all(experiment.learns[method])
        if self.uses_seed_simulator(job):
            self.simulator(int(job.seed))
        with status.track_runs():
            train.run(job)
        run = find_run(train.naming_configuration(job), "train")
        if run is None or not run.done:
            raise KeyboardInterrupt
        return run

    def _fit_all(self, training: str) -> None:
        """Make the missing fits of a training."""
        for overrides in (fit for fits in self.pairs(training).values() for fit in fits):
            self._call_once(self.fit_digest(overrides), partial(self.make_fit, overrides))

    def _call_once(self, digest: str, make: Callable[[], T]) -> T:
        """Call ``make`` and return its result. A failed run is not repeated: its error is raised again."""
        if digest in self.failures:
            raise self.failures[digest]
        try:
            return make()
        except Exception as error:
            self.failures[digest] = error
            raise

    def _digest(self, key: tuple[Any, ...], configured: Callable[[], DictConfig]) -> str:
        """A run's digest, cached by key, since many methods need the same fits and trainings."""
        if key not in self._digests:
            self._digests[key] = run_digest(configured(), str(key[0]))
        return self._digests[key]
