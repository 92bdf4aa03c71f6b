"""Scenes that nothing may be trained on or chosen by: the test scenes of docs/data.md."""

import re
from collections.abc import Iterable
from pathlib import Path

from gaussian_enhancer.errors import InputError

FROZEN_CAPTURES = ("fox", "monstree")
FROZEN_FROM = 2000
"""First seed of the procedural test scenes."""
PROCEDURAL = re.compile(r"(?:unbounded|outdoor|indoor|object)_(\d+)-")


def is_frozen(run: str | Path) -> bool:
    """Whether the folder of a fitted run, or a pattern of such folders, names a test scene.

    Args:
        run: for instance "runs/fit/fox-3dgs-1a2b3c4d" or "runs/fit/object_2000-*".
    """
    name = Path(run).name
    seed = PROCEDURAL.match(name)
    return name.startswith(tuple(f"{capture}-" for capture in FROZEN_CAPTURES)) or (
        seed is not None and int(seed[1]) >= FROZEN_FROM
    )


def refuse_frozen(runs: Iterable[str | Path], purpose: str) -> None:
    """Refuse runs of test scenes.

    Args:
        runs: folders of fitted runs.
        purpose: what is made of them, in words: "trained on", "chosen by".

    Raises:
        InputError: one of them is a test scene's.
    """
    for run in runs:
        if is_frozen(run):
            remedy = "name training or validation runs (docs/data.md); a capture of your own needs another scene.name"
            raise InputError(run, f"is a frozen test scene, which nothing may be {purpose}", remedy)
