"""Scenes that nothing may be trained on, and those of them that nothing may be chosen by (docs/data.md)."""

import re
from collections.abc import Iterable
from pathlib import Path

from gaussian_enhancer.errors import InputError

FROZEN_CAPTURES = ("fox", "monstree")
FROZEN_FAMILY = "harbour"
"""The procedural family that no training scene is drawn from."""
FROZEN_FROM = 5000
"""First seed of the procedural test scenes."""
UNTRAINED_FROM = 2000
"""First seed of the procedural scenes of the second validation, which no weights learn from."""
PROCEDURAL = re.compile(r"(unbounded|outdoor|indoor|object|harbour)_(\d+)-")


def is_frozen(run: str | Path) -> bool:
    """Whether the folder of a fitted run, or a pattern of such folders, names a test scene.

    Args:
        run: for instance "runs/fit/fox-3dgs-1a2b3c4d" or "runs/fit/object_5000-*".
    """
    captured = Path(run).name.startswith(tuple(f"{capture}-" for capture in FROZEN_CAPTURES))
    return captured or _is_procedural(run, FROZEN_FROM)


def is_untrained(run: str | Path) -> bool:
    """Whether a run names a scene that no weights may learn from: a test scene, or one of the second validation.

    Args:
        run: as `is_frozen` takes it.
    """
    return is_frozen(run) or _is_procedural(run, UNTRAINED_FROM)


def _is_procedural(run: str | Path, first: int) -> bool:
    """Whether a run names a procedural scene from a seed on, or of the family that is frozen at every seed."""
    match = PROCEDURAL.match(Path(run).name)
    return match is not None and (match[1] == FROZEN_FAMILY or int(match[2]) >= first)


def refuse_frozen(runs: Iterable[str | Path], purpose: str = "chosen by") -> None:
    """Refuse runs of test scenes.

    Args:
        runs: folders of fitted runs.
        purpose: what is made of them, in words.

    Raises:
        InputError: one of them is a test scene's.
    """
    for run in runs:
        if is_frozen(run):
            remedy = "name training or validation runs (docs/data.md); a capture of your own needs another scene.name"
            raise InputError(run, f"is a frozen test scene, which nothing may be {purpose}", remedy)


def refuse_untrained(runs: Iterable[str | Path]) -> None:
    """Refuse runs that no weights may learn from.

    Args:
        runs: folders of fitted runs.

    Raises:
        InputError: one of them is a test scene's, or one of the second validation.
    """
    for run in runs:
        refuse_frozen([run], "trained on")
        if is_untrained(run):
            remedy = f"name training runs: procedural seeds below {UNTRAINED_FROM} (docs/data.md)"
            raise InputError(run, "is a scene of the second validation, which nothing may be trained on", remedy)
