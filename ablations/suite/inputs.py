"""The files that a scene's configuration needs, how to obtain missing ones, and the published time of its fit.

For dry runs: nothing is fitted, downloaded or written. A published scene that is there is read as its fit reads it,
without decoding its photos.
"""

import os
import re
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from gaussian_enhancer.configurations import configurations
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import read_configuration
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.scene.datasets import dataset_names, published_dataset
from gaussian_enhancer.scene.published import download_command, missing_parts

PUBLISHED = "gaussian_enhancer.scene.published.load_published"
VARIABLE = re.compile(r"\$\{oc\.env:(\w+)\}")
FIT_STEPS = 30_000
"""Number of steps of the fits whose times were published."""


def describe_missing(scene: DictConfig) -> tuple[str, ...]:
    """Texts that say what a scene lacks and how to obtain it; empty if its fit can load it.

    Args:
        scene: a scene's configuration, as the job fit has it under ``scene``; its folder may refer to an environment
            variable that is not set.

    Raises:
        InputError: the configuration names an unknown dataset.
    """
    variable = unset_variable(scene)
    if variable and scene.get("_target_") == PUBLISHED:
        command = f"gaussian-enhancer download dataset={scene.dataset}"
        return (f"set {variable} to the folder of the data sets ({command})",)
    if missing := missing_inputs(scene):
        (path, remedy), *others = missing  # one command obtains all of them
        also = f" (also missing: {', '.join(str(other) for other, _ in others)})" if others else ""
        return (f"{path} does not exist; {remedy}{also}",)
    return _refusal(scene) if scene.get("_target_") == PUBLISHED else ()


def unset_variable(scene: DictConfig) -> str:
    """The environment variable in the path of a scene's folder that is not set; empty if there is none.

    Args:
        scene: a scene's configuration, as the job fit has it under ``scene``.
    """
    return _path(scene)[1]


def held_out_views(scene: DictConfig) -> int | None:
    """Number of held-out photos of a published scene; None for any other scene.

    Args:
        scene: a scene's configuration, as the job fit has it under ``scene``.
    """
    if scene.get("_target_") != PUBLISHED or scene.dataset not in dataset_names():
        return None
    own_split, photos = published_dataset(scene.dataset).test_photos, scene.get("photos")
    return own_split if own_split is not None or photos is None else -(-int(photos) // int(scene.split.test_every))


def missing_inputs(scene: DictConfig) -> list[tuple[Path, str]]:
    """Files and folders that a scene needs and that are missing, each with instructions to obtain it.

    Args:
        scene: a scene's configuration, as the job fit has it under ``scene``.

    Returns:
        Path and remedy of each; empty if nothing is missing, or nothing is needed (procedural scenes).

    Raises:
        InputError: the configuration names an unknown dataset.
    """
    path, unset = _path(scene)
    if path is None:
        return []
    variable_hint = f"set {unset} to a folder, then " if unset else ""
    if scene.get("_target_") == PUBLISHED:
        missing = missing_parts(path, scene.dataset, scene.get("downscale", 1))
        remedy = download_command(path, scene.dataset, scene.name, scene.get("downscale", 1))
        return [(part, variable_hint + remedy) for part in missing]
    return [] if path.exists() else [(path, f"{variable_hint}put the capture there, or give its folder as scene.path")]


def published_fit_minutes(scene: DictConfig) -> float | None:
    """Published GPU minutes of one fit of `FIT_STEPS` steps (docs/datasets.md); None if none were published.

    Args:
        scene: a scene's configuration, as the job fit has it under ``scene``.
    """
    if scene.get("_target_") != PUBLISHED or scene.dataset not in dataset_names():
        return None
    facts = published_dataset(scene.dataset).scenes.get(scene.name)
    if facts is None:
        return None
    official = read_configuration(configurations() / "scene" / "datasets" / f"{scene.name}.yaml")
    factor = official.get("downscale", 1) / scene.get("downscale", 1)
    return facts.fit_seconds * max(1.0, factor**2) / 60


def _refusal(scene: DictConfig) -> tuple[str, ...]:
    """Why the loader of the fit refuses a published scene, for instance for its number of photos; empty if not."""
    try:
        build(scene)
    except InputError as error:
        return (str(error),)
    return ()


def _path(scene: DictConfig) -> tuple[Path | None, str]:
    """The scene's folder, and the environment variable in its path that is not set (the path is then ``$NAME/...``)."""
    values = OmegaConf.to_container(scene, resolve=False)
    if not isinstance(values, dict):
        raise InputError("scene", "is no mapping", "compose it from conf/scene")
    raw = values.get("path")
    if raw is None or raw == "???":
        return None if raw is None else Path("scene.path"), ""
    unset = [name for name in VARIABLE.findall(raw) if name not in os.environ]
    if not unset:
        return Path(scene.path), ""
    path_with_names = VARIABLE.sub(lambda match: f"${match[1]}" if match[1] in unset else match[0], raw)
    other_values = {key: value for key, value in values.items() if key != "path"}
    return Path(OmegaConf.create({**other_values, "path": path_with_names}).path), unset[0]
