"""Scenes excluded from training, and the test scenes among them, also excluded from any choice (docs/data.md)."""

import re
from collections.abc import Iterable
from pathlib import Path

from gaussian_enhancer.errors import InputError

FROZEN_CAPTURES = ("fox", "monstree")
FROZEN_FAMILY = "harbour"
"""The procedural family whose scenes are test scenes at every seed."""
FROZEN_FROM = 5000
"""First seed of the procedural test scenes."""
UNTRAINED_FROM = 2000
"""First seed of the procedural scenes of the second validation, which are excluded from training."""
PROCEDURAL = re.compile(r"(unbounded|outdoor|indoor|object|harbour)_(\d+)-")


def is_frozen(run: str | Path) -> bool:
    """Whether the name of a fitted run's folder is that of a test scene.

    Args:
        run: for instance "runs/fit/fox-3dgs-1a2b3c4d".
    """
    is_frozen_capture = Path(run).name.startswith(tuple(f"{capture}-" for capture in FROZEN_CAPTURES))
    return is_frozen_capture or _is_procedural(run, FROZEN_FROM)


def is_untrained(run: str | Path) -> bool:
    """Whether a run's scene is excluded from training: a test scene, or a scene of the second validation.

    Args:
        run: see `is_frozen`.
    """
    return is_frozen(run) or _is_procedural(run, UNTRAINED_FROM)


def _is_procedural(run: str | Path, first_seed: int) -> bool:
    """Whether a run's scene is procedural, with a seed of at least ``first_seed`` or of the family `FROZEN_FAMILY`."""
    match = PROCEDURAL.match(Path(run).name)
    return match is not None and (match[1] == FROZEN_FAMILY or int(match[2]) >= first_seed)


def refuse_frozen(runs: Iterable[str | Path], purpose: str = "chosen by") -> None:
    """Refuse runs of test scenes.

    Args:
        runs: folders of fitted runs.
        purpose: the refused use, as a participle for the error message.

    Raises:
        InputError: a run is of a test scene.
    """
    for run in runs:
        if is_frozen(run):
            remedy = "name training or validation runs (docs/data.md); a capture of your own needs another scene.name"
            raise InputError(run, f"is a frozen test scene: nothing may be {purpose} it", remedy)


def refuse_untrained(runs: Iterable[str | Path]) -> None:
    """Refuse runs whose scenes are excluded from training.

    Args:
        runs: folders of fitted runs.

    Raises:
        InputError: a run is of a test scene or of a scene of the second validation.
    """
    for run in runs:
        refuse_frozen([run], "trained on")
        if is_untrained(run):
            remedy = f"name training runs: procedural seeds below {UNTRAINED_FROM} (docs/data.md)"
            raise InputError(run, "is a scene of the second validation, which must not be used for training", remedy)
