"""The runs behind a table's methods: which they are, and making those that are missing.

Every run is addressed by what determines it, so that its place is known before anything was made: a training by its
fits' digests, a method in a cell by those of its fit and its training. Equal methods of different tables are one run.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import DictConfig, OmegaConf, open_dict

from ablations.suite.descriptions import Experiment
from ablations.suite.evaluation import StudyCell, composed, images_of, measure_now
from gaussian_enhancer.cli import train, train_generator
from gaussian_enhancer.cli.pipeline import finished_fit
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.backbones import data_backbones
from gaussian_enhancer.metrics.image_folders import Label
from gaussian_enhancer.metrics.lpips import perceptual_distance
from gaussian_enhancer.metrics.pair import PROTOCOL
from gaussian_enhancer.metrics.records import Record, read_records, write_records
from gaussian_enhancer.runs import status as status
from gaussian_enhancer.runs.compose import compose_job
from gaussian_enhancer.runs.instantiate import require
from gaussian_enhancer.runs.run import Run, find_run, open_run, run_digest
from gaussian_enhancer.train.trainer import alike

T = TypeVar("T")

WEIGHTS = "weights.safetensors"


def train_key(experiment: Experiment, method: str, seed: int) -> tuple[Any, ...]:
    """What tells a method's training from others without composing its configuration."""
    return ("train", experiment.learns[method], *experiment.table.methods[method].train, seed)


def with_backbones(cfg: DictConfig) -> DictConfig:
    """Name the data folder's LPIPS backbones where none are given: the names of measured runs depend on them."""
    beside = data_backbones()
    if cfg.backbones is None and beside is not None:
        with open_dict(cfg):
            cfg.backbones = str(beside)
    return cfg


class Runs:
    """The runs of a suite.

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
            InputError: it is refused, or refers to what is not set.
        """
        return composed("fit", self.cfg, overrides)

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
            side: [tuple(map(str, (*own, *scale.fit, *scale.sparse))) for own in fits] for side, fits in sides.items()
        }

    def train_job(self, experiment: Experiment, method: str, seed: int) -> DictConfig:
        """Configuration of the job train, on exactly the fits that the scale names; loggers group it by its table.

        Raises:
            InputError: it is refused, or leaves a mandatory value open.
        """
        job = compose_job("train", self.cfg, [*experiment.table.methods[method].train, f"seed={seed}"])
        self._learn_from(job, experiment.learns[method])
        job.study = experiment.table.name
        if self.own_simulator(job):
            run = self.simulator_job(seed)
            job.generator.weights = (
                f"{self.cfg.runs}/train_generator/{run.label}-{self.simulator_digest(seed)}/{WEIGHTS}"
            )
        require(job)
        return job

    def own_simulator(self, job: DictConfig) -> bool:
        """Whether a training learns from a second stage that the scale trains again for its seed.

        Args:
            job: configuration of the job train.
        """
        own = self.cfg.scale.get("simulator") is not None
        return own and float(job.data.simulation.share) > 0 and bool(job.generator.get("weights"))

    def simulator_job(self, seed: int) -> DictConfig:
        """Configuration of the job train_generator for a seed: on the fits of one of the scale's trainings.

        Raises:
            InputError: it is refused, or leaves a mandatory value open.
        """
        chosen = self.cfg.scale.simulator
        job = compose_job("train_generator", self.cfg, [*map(str, chosen.train), f"seed={seed}"])
        self._learn_from(job, str(chosen.learns))
        require(job)
        return job

    def simulator_digest(self, seed: int) -> str:
        """The digest of a seed's second stage."""
        return self._digest(("train_generator", seed), lambda: alike(self.simulator_job(seed)))

    def simulator(self, seed: int) -> Run:
        """A seed's second stage, trained now where it is missing, its fits before it.

        Raises:
            InputError: it is missing and shall not be trained, or cannot be.
            KeyboardInterrupt: the user stopped the training.
        """
        return self._tried(self.simulator_digest(seed), lambda: self._simulator(seed))

    def _simulator(self, seed: int) -> Run:
        job = self.simulator_job(seed)
        found = find_run(alike(job), "train_generator")
        if found is None or not found.done:
            if not self.cfg.train_missing:
                remedy = f"gaussian-enhancer tables scale={self.cfg.scale.name}"
                raise InputError(f"the simulator of seed {seed}", "is not trained yet", remedy)
            self._fit_all(str(self.cfg.scale.simulator.learns))
            with status.attempt():
                train_generator.run(job)
            found = find_run(alike(job), "train_generator")
        if found is None or not found.done:
            raise KeyboardInterrupt
        return found

    def _learn_from(self, job: DictConfig, training: str) -> None:
        """Let a job learn from exactly the fits of one of the scale's trainings, and say so on its card."""
        for side, fits in self.pairs(training).items():
            job.data[side] = [f"{self.cfg.runs}/fit/*-{self.fit_digest(one)}" for one in fits]
        job.card = {"licence": "Apache-2.0", "data": f"Renders of the fits that scale {self.cfg.scale.name} names."}

    def train_digest(self, experiment: Experiment, method: str, seed: int) -> str:
        """The digest of a method's training."""
        key = train_key(experiment, method, seed)
        return self._digest(key, lambda: train.with_effect(self.train_job(experiment, method, seed)))

    def row_job(self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None) -> DictConfig:
        """What determines a method's records in a cell; ``seed`` is None where it learns nothing."""
        choice = experiment.table.methods[method]
        learnt = "" if seed is None else self.train_digest(experiment, method, seed)
        scene_keys = {"scene": cell.scene, "splat": cell.splat, "fit": self.fit_digest(cell.fit)}
        settings = {"enhance": list(choice.enhance), "upscale": choice.upscale, "render": choice.render}
        measured = {"every": cell.every, "finer": cell.finer, "protocol": PROTOCOL, "lpips": self.measurable()}
        values = {**scene_keys, "train": learnt, "weights": choice.weights, **settings, **measured}
        return OmegaConf.create({"runs": self.cfg.runs, **values})

    def measurable(self) -> dict[str, bool]:
        """The LPIPS distances of the scale, and whether there is a backbone for each."""
        if self._measurable is None:
            found = {str(name): perceptual_distance(name, self.cfg.backbones) for name in self.cfg.scale.lpips}
            self._measurable = {name: one.network is not None for name, one in found.items()}
        return self._measurable

    def weights(self, experiment: Experiment, method: str, seed: int | None) -> str:
        """The weights of a method, trained now where they are missing, with the fits that they learn from.

        Raises:
            InputError: they are missing and shall not be trained, or cannot be.
            KeyboardInterrupt: the user stopped the training.
        """
        if seed is None:
            return experiment.table.methods[method].weights
        job = self.train_job(experiment, method, seed)
        found = find_run(train.with_effect(job), "train")
        if found is None or not found.done:
            if not self.cfg.train_missing:
                command = f"gaussian-enhancer tables table={experiment.table.name} scale={self.cfg.scale.name}"
                raise InputError(f"weights of {method}, seed {seed}", "are not trained yet", command)
            found = self._tried(
                self.train_digest(experiment, method, seed), lambda: self._trained(experiment, method, job)
            )
        return str(found.folder / WEIGHTS)

    def make(self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None) -> None:
        """Make a method's records in a cell, with all that they need, where they are missing.

        Raises:
            InputError: the method cannot be made here.
        """
        job = self.row_job(experiment, cell, method, seed)
        found = find_run(job, "row")
        if found is None or not found.done:
            self._tried(run_digest(job, "row"), lambda: self._made(experiment, cell, method, seed, job))

    def records(self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None) -> tuple[Record, ...]:
        """A method's records in a cell, which were made before.

        Raises:
            InputError: they are not there, or were damaged.
        """
        folder = self._row_folder(experiment, cell, method, seed)
        return tuple(replace(one, variant=method, seed=seed) for one in read_records(folder / "records.jsonl"))

    def images(self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None) -> tuple[Path, Path]:
        """The folders of a method's images in a cell and of their photos.

        Raises:
            InputError: they were not made.
        """
        file = self._row_folder(experiment, cell, method, seed) / "images.json"
        where = json.loads(file.read_text(encoding="utf-8"))
        return Path(where["images"]), Path(where["photos"])

    def _row_folder(self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None) -> Path:
        found = find_run(self.row_job(experiment, cell, method, seed), "row")
        if found is None or not found.done:
            raise InputError(f"{method} in {cell.scene}, {cell.splat}", "is not measured yet", "make the table")
        return found.folder

    def _made(self, experiment: Experiment, cell: StudyCell, method: str, seed: int | None, job: DictConfig) -> None:
        choice = experiment.table.methods[method]
        with status.attempt():
            own = open_run(job, "row", f"{cell.scene}-{cell.splat}-{method}")
            cell_fit = self._tried(job.fit, partial(self.fitted, cell.fit))
            weights = self.weights(experiment, method, seed)
            settings: dict[str, Any] = {"weights": weights, "enhance": list(choice.enhance)}
            settings |= {"upscale": choice.upscale, "render": choice.render}
            images = images_of(self.cfg, cell, method, OmegaConf.create(settings))
            label = Label(images.run, cell.scene, cell.splat, method)
            measures = OmegaConf.create({"lpips": list(self.measurable()), "backbones": self.cfg.backbones})
            measures.runtime = self.cfg.runtime
            sources = {**images.sources, "fit": cell_fit.folder.name}
            if seed is not None:
                sources["train"] = Path(weights).parent.name
            found = [
                replace(one, seed=seed, sources=sources, weights=images.weights)
                for one in measure_now(measures, label, images)
            ]
            write_records(own.folder / "records.jsonl", found)
            where = {"images": str(images.folder), "photos": str(images.photos)}
            write_text(own.folder / "images.json", json.dumps(where) + "\n")
            own.finish()

    def fitted(self, overrides: Sequence[str]) -> Run:
        """A finished fit, made now where it is missing.

        Raises:
            InputError: it is missing and shall not be made, or cannot be.
        """
        refusal = InputError("the fit", "is not made yet", f"gaussian-enhancer fit {' '.join(overrides)}")
        return finished_fit(self.fit_job(overrides), None if self.cfg.fit_missing else refusal)

    def _trained(self, experiment: Experiment, method: str, job: DictConfig) -> Run:
        """A finished training, its fits and its simulator before it."""
        self._fit_all(experiment.learns[method])
        if self.own_simulator(job):
            self.simulator(int(job.seed))
        with status.attempt():
            train.run(job)
        found = find_run(train.with_effect(job), "train")
        if found is None or not found.done:
            raise KeyboardInterrupt
        return found

    def _fit_all(self, training: str) -> None:
        """Make the fits of a training that are missing."""
        for overrides in (one for fits in self.pairs(training).values() for one in fits):
            self._tried(self.fit_digest(overrides), partial(self.fitted, overrides))

    def _tried(self, digest: str, make: Callable[[], T]) -> T:
        """What a run gives; one that failed is not tried again by every method that needs it."""
        if digest in self.failures:
            raise self.failures[digest]
        try:
            return make()
        except Exception as error:
            self.failures[digest] = error
            raise

    def _digest(self, key: tuple[Any, ...], configured: Callable[[], DictConfig]) -> str:
        """A digest, reckoned once: many methods need the same fits and trainings."""
        if key not in self._digests:
            self._digests[key] = run_digest(configured(), str(key[0]))
        return self._digests[key]
