"""Reads the settings that the job tradeoff compares from ``conf/curves``."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from omegaconf import DictConfig

from ablations.suite.evaluation import StudyCell
from gaussian_enhancer.errors import InputError, refuse_unknown
from gaussian_enhancer.network.baselines.bicubic import Bicubic
from gaussian_enhancer.network.baselines.identity import Identity
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.runs.instantiate import plain_values

NULL_NETWORKS: dict[str, Callable[[], Network]] = {"identity": Identity, "bicubic": Bicubic}
KEYS = ("network", "weights", "train", "enhance", "upscale", "compiled", "only")


@dataclass(frozen=True)
class Setting:
    """One point of a curve.

    Args:
        name: "curve/setting".
        weights: shipped name or file of the weights; empty if ``network`` or ``train`` is given.
        network: one of `NULL_NETWORKS`, or empty.
        train: overrides of the job train that makes the weights, beside those of the scale's usual training.
        enhance: overrides of the job enhance.
        upscale: upsample bicubically at the end.
        compiled: compile the network by torch.compile.
        only: the only device that this can be measured on; empty for any.
    """

    name: str
    weights: str = ""
    network: str = ""
    train: tuple[str, ...] = ()
    enhance: tuple[str, ...] = ()
    upscale: bool = False
    compiled: bool = False
    only: str = ""

    def __post_init__(self) -> None:
        sources = [name for name in ("weights", "network", "train") if getattr(self, name)]
        if len(sources) != 1:
            raise InputError(
                self.name, f"names {' and '.join(sources) or 'no network'}", "name one of network, weights, train"
            )
        if self.network and self.network not in NULL_NETWORKS:
            raise InputError(self.name, f"has network {self.network!r}", f"choose {', '.join(NULL_NETWORKS)}")

    @property
    def reproducible_by_enhance(self) -> bool:
        """Whether the job enhance can reproduce this setting with weights and overrides alone."""
        return bool(self.weights) and not (self.upscale or self.compiled)


@dataclass(frozen=True)
class TradeoffStudy:
    """Settings that are measured in turn, and the scenes that they are measured on.

    Args:
        name: its key.
        title: its heading.
        cells: scenes, named "side/difficulty/scene".
        settings: settings of all curves.
        views: number of views per scene.
        repeats: largest number of repeats of each time.
        seconds: time limit of all repeats on one view; the last round may exceed it.
        finer: whether images have 4 times the renders' resolution.
    """

    name: str
    title: str
    cells: tuple[StudyCell, ...]
    settings: tuple[Setting, ...]
    views: int
    repeats: int
    seconds: float = math.inf
    finer: bool = False


def read_studies(cfg: DictConfig) -> tuple[TradeoffStudy, ...]:
    """Read the studies of a configuration that the user selects.

    Raises:
        InputError: a study is unknown, or a setting is invalid.
    """
    curves = plain_values(cfg.curves)
    density = tuple(curves.pop("density"))
    selected = tuple(curves) if cfg.studies is None else tuple(cfg.studies)
    refuse_unknown("studies", selected, curves)
    studies = [_study(name, curves[name], density) for name in selected]
    views = sum(study.views * len(study.cells) for study in studies)
    return tuple(replace(study, seconds=60 * float(cfg.minutes) / max(1, views)) for study in studies)


def _study(name: str, values: Mapping[str, Any], density: tuple[str, ...]) -> TradeoffStudy:
    settings = tuple(_settings(values["curves"]))
    finer = bool(values.get("finer"))
    cells = tuple(
        StudyCell(f"{side}/{level}/{scene}", "3dgs", (*overrides, *density, *values.get("fit", ())), finer=finer)
        for side, levels in values["scenes"].items()
        for level, scenes in levels.items()
        for scene, overrides in scenes.items()
    )
    return TradeoffStudy(
        name, values["title"], cells, settings, int(values["views"]), int(values["repeats"]), finer=finer
    )


def _settings(curves: Mapping[str, Any]) -> Iterator[Setting]:
    for curve, common in curves.items():
        curve_values = {key: value for key, value in common.items() if key != "settings"}
        for name, setting_values in common["settings"].items():
            values = {**curve_values, **setting_values}
            if unknown_keys := set(values) - set(KEYS):
                raise InputError(f"{curve}/{name}", f"has a key {sorted(unknown_keys)[0]!r}", f"use {', '.join(KEYS)}")
            tuples = {key: tuple(values[key]) for key in ("train", "enhance") if key in values}
            yield Setting(f"{curve}/{name}", **{**values, **tuples})
