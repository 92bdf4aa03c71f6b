"""What a scene's configuration needs on disk, how to get what is missing, and what the scene costs on a GPU.

For dry runs: nothing is loaded, fitted or fetched.
"""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from gaussian_enhancer.apps.build import plain
from gaussian_enhancer.apps.cli import configurations
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.datasets import Dataset, dataset_of
from gaussian_enhancer.scene.published import download_command, missing_parts
from gaussian_enhancer.scene.splits import every_nth

PUBLISHED = "gaussian_enhancer.scene.published.load_published"
VARIABLE = re.compile(r"\$\{oc\.env:(\w+)\}")
ENHANCE_SECONDS = 0.45
"""Seconds to enhance a megapixel at its own resolution on one RTX 3090, by the paper's table 3 (459 ms at "1K", which
it does not define in pixels; taken as one megapixel). An upper bound: the networks here do less."""


@dataclass(frozen=True)
class SceneCost:
    """What one scene of a published dataset costs.

    Args:
        photos: all photos.
        test_photos: held-out photos, which are enhanced and measured.
        width: of a photo, in pixels.
        height: of a photo, in pixels.
        fit_hours: GPU hours of one fit by one splatting method.
        enhance_hours: GPU hours to enhance the held-out photos once.
        basis: what the hours rest on, in words.
    """

    photos: int
    test_photos: int
    width: int
    height: int
    fit_hours: float
    enhance_hours: float
    basis: str

    @property
    def megapixels(self) -> float:
        """Of all held-out photos together."""
        return self.test_photos * self.width * self.height / 1e6


def missing_inputs(scene: DictConfig) -> list[tuple[Path, str]]:
    """What a scene needs on disk and is not there, each with how to get it.

    Args:
        scene: a scene's configuration, as the job fit has it under ``scene``.

    Returns:
        Path and remedy of each; empty where everything is there, or nothing is needed (procedural scenes).

    Raises:
        InputError: the configuration names an unknown dataset.
    """
    path, unset = _path(scene)
    if path is None:
        return []
    first = f"set {unset} to a folder, then " if unset else ""
    if scene.get("_target_") == PUBLISHED:
        absent = missing_parts(path, scene.dataset, scene.get("downscale", 1))
        remedy = download_command(path, scene.dataset, scene.name, scene.get("downscale", 1))
        return [(part, first + remedy) for part in absent]
    return [] if path.exists() else [(path, f"{first}put the capture there, or give its folder as scene.path")]


def scene_cost(scene: DictConfig) -> SceneCost | None:
    """What a scene of a published dataset costs; None for any other scene.

    Args:
        scene: a scene's configuration, as the job fit has it under ``scene``.

    Raises:
        InputError: the dataset has no such scene.
    """
    if scene.get("_target_") != PUBLISHED:
        return None
    dataset = registered(scene.dataset)
    facts = dataset.chosen((scene.name,))[scene.name]
    official = _values(_file("scene/datasets", scene.name))
    photos = int(official["photos"] if scene.photos is None else scene.photos)
    split = plain(scene.split)
    held_out = dataset.test_photos or len(every_nth(photos, split["test_every"], split.get("test_offset", 0))[1])
    factor = official.get("downscale", 1) / scene.get("downscale", 1)
    width, height = round(facts.width * factor), round(facts.height * factor)
    enhance = held_out * width * height / 1e6 * ENHANCE_SECONDS / 3600
    basis = f"fit: {dataset.fit_basis}; enhancing: {ENHANCE_SECONDS} s a megapixel, the paper's table 3 on an RTX 3090"
    hours = facts.fit_seconds * max(1.0, factor**2) / 3600
    return SceneCost(photos, held_out, width, height, hours, enhance, basis)


@cache
def registered(name: str) -> Dataset:
    """A dataset of ``conf/dataset``.

    Raises:
        InputError: there is none of that name.
    """
    return dataset_of(_values(_file("dataset", name)))


def _file(folder: str, name: str) -> Path:
    file = configurations() / folder / f"{name}.yaml"
    if not file.is_file():
        known = ", ".join(sorted(path.stem for path in file.parent.glob("*.yaml")))
        raise InputError(folder, f"has no {name!r}", f"choose from {known}")
    return file


def _values(file: Path) -> Mapping[str, Any]:
    content = OmegaConf.load(file)
    if not isinstance(content, DictConfig):
        raise InputError(file, "is no mapping", "restore it")
    return plain(content)


def _path(scene: DictConfig) -> tuple[Path | None, str]:
    """The scene's folder, and the environment variable that it hangs on where that is not set (then ``$NAME/...``)."""
    values = OmegaConf.to_container(scene, resolve=False)
    if not isinstance(values, dict):
        raise InputError("scene", "is no mapping", "compose it from conf/scene")
    raw = values.get("path")
    if raw is None or raw == "???":
        return None if raw is None else Path("scene.path"), ""
    unset = [name for name in VARIABLE.findall(raw) if name not in os.environ]
    if not unset:
        return Path(scene.path), ""
    known = VARIABLE.sub(lambda found: f"${found[1]}" if found[1] in unset else found[0], raw)
    others = {key: value for key, value in values.items() if key != "path"}
    return Path(OmegaConf.create({**others, "path": known}).path), unset[0]
