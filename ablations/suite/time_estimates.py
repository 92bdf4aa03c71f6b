"""Estimates how long runs take: from finished runs of the same kind, else published times, else the scale's values."""

import json
import statistics
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from ablations.suite.inputs import FIT_STEPS, published_fit_minutes
from gaussian_enhancer.input_files import read_configuration
from gaussian_enhancer.runs.status import DONE

VIEWS = 9
"""Assumed number of measured views of a cell, if its fit does not exist yet and its scene does not tell."""


class Estimates:
    """Time estimates from the finished runs of a folder.

    Args:
        runs: the folder of runs.
        scale: one of ``conf/scale``; its ``minutes`` are the fallback.
    """

    def __init__(self, runs: Path, scale: DictConfig) -> None:
        self.folder, self.scale = runs, scale
        self.fits = _medians(_finished_fits(runs))
        self.trainings = _medians(_finished_trainings(runs))

    def minutes(self, job: str, cfg: DictConfig, finer: bool = False, views: int | None = None) -> float:
        """Estimate the minutes of a run from its configuration.

        Args:
            job: "fit", "train_generator", "train", "row" or "cost".
            cfg: its configuration.
            finer: whether a method is measured against photos of 4 times the resolution.
            views: number of held-out views of a row's scene, if it is known before the fit exists.
        """
        if job == "fit":
            published = published_fit_minutes(cfg.scene)
            default_minutes_per_step = (
                float(self.scale.minutes.fit) / 1000 if published is None else published / FIT_STEPS
            )
            return self.fits.get(_fit_kind(cfg), default_minutes_per_step) * float(cfg.settings.steps)
        if job == "train_generator":
            return float(self.scale.minutes.train_generator) / 1000 * (int(cfg.paired.steps) + int(cfg.diffused.steps))
        if job == "train":
            default_minutes_per_step = float(self.scale.minutes.train) / 1000
            return self.trainings.get(_training_kind(cfg), default_minutes_per_step) * float(cfg.trainer.max_steps)
        if job == "cost":
            pixels = int(cfg.shape[0]) * int(cfg.shape[1]) * len(cfg.train) * (int(cfg.repeats) + 2)
            return pixels / 1e6 * float(self.scale.minutes.megapixel)
        photo_folders = sorted((self.folder / "fit").glob(f"*-{cfg.fit}/test/ours_*/gt"))
        expected = VIEWS * int(cfg.every) if views is None else views
        found = len(list(photo_folders[0].iterdir())) if photo_folders else expected
        return -(-found // int(cfg.every)) * self._minutes_per_view(finer)

    def minutes_without_config(
        self, job: str, overrides: Sequence[Any], finer: bool = False, views: int | None = None
    ) -> float:
        """Estimate the minutes of a run whose configuration cannot be composed, for instance without its dataset.

        Args:
            job: "fit", "train" or "row"; any other job gives 0.
            overrides: of its job; without a number of steps, the estimate of "fit" and "train" is 0.
            finer: whether a method is measured against photos of 4 times the resolution.
            views: number of measured views of a row; `VIEWS` where None.
        """
        if job == "row":
            return (VIEWS if views is None else views) * self._minutes_per_view(finer)
        key = "settings.steps=" if job == "fit" else "trainer.max_steps="
        steps = [float(word.split("=")[1]) for word in map(str, overrides) if word.startswith(key)]
        return steps[-1] / 1000 * float(self.scale.minutes[job]) if steps else 0.0

    def _minutes_per_view(self, finer: bool) -> float:
        return float(self.scale.minutes.finer_view if finer else self.scale.minutes.view)


def _medians(entries: Iterator[tuple[str, float]]) -> dict[str, float]:
    """Median minutes per step, by kind of run."""
    minutes_by_kind: dict[str, list[float]] = {}
    for kind, minutes in entries:
        minutes_by_kind.setdefault(kind, []).append(minutes)
    return {kind: statistics.median(values) for kind, values in minutes_by_kind.items()}


def _finished_fits(runs: Path) -> Iterator[tuple[str, float]]:
    for cfg, file in _finished_runs(runs / "fit", "records.jsonl"):
        last_record = json.loads(file.read_text(encoding="utf-8").rstrip("\n").split("\n")[-1])
        milliseconds = last_record["metrics"]["milliseconds"]
        if milliseconds is not None:  # unknown for fits that were interrupted
            yield _fit_kind(cfg), milliseconds / 60e3 / cfg["settings"]["steps"]


def _finished_trainings(runs: Path) -> Iterator[tuple[str, float]]:
    for cfg, file in _finished_runs(runs / "train", "card.json"):
        if "loading" in cfg["data"]:  # absent from runs of earlier versions
            card = json.loads(file.read_text(encoding="utf-8"))
            if card["minutes"] is not None:  # unknown for trainings that were interrupted
                yield _training_kind(cfg), card["minutes"] / max(1, card["steps"])


def _finished_runs(folder: Path, name: str) -> Iterator[tuple[dict[str, Any], Path]]:
    """Configuration and file ``name`` of each finished run that has both."""
    for marker in sorted(folder.glob(f"*/{DONE}")):
        config, file = marker.with_name("config.yaml"), marker.with_name(name)
        if config.is_file() and (cfg := read_configuration(config)) and file.is_file():
            yield cfg, file


def _fit_kind(cfg: Mapping[str, Any]) -> str:
    """A key of fits that take about equally long: same method, image size and number of steps."""
    scene, settings = cfg["scene"], cfg["settings"]
    size = [scene.get(key) for key in ("_target_", "family", "height", "width", "downscale")]
    return json.dumps([cfg["splat"]["_target_"], *size, settings["steps"], settings["max_gaussians"]])


def _training_kind(cfg: Mapping[str, Any]) -> str:
    """A key of trainings that take about equally long: same network, widths, batch size and crops."""
    fusion, data = cfg["fusion"], cfg["data"]
    crop = data["augmentation"]["crop"]
    return json.dumps([fusion["_target_"], list(fusion.get("widths", ())), data["loading"]["batch_size"], crop])
