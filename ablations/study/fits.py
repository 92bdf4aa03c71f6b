"""Finds the finished fits that a study measures, and the scenes that they were fitted to."""

from collections.abc import Sequence
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import matching_paths
from gaussian_enhancer.metrics.records import read_records
from gaussian_enhancer.runs.status import DONE
from gaussian_enhancer.scene.frozen import is_frozen, refuse_frozen
from gaussian_enhancer.scene.renders import run_steps


def finished_runs(patterns: Sequence[str]) -> tuple[list[Path], list[Path]]:
    """Folders that match patterns: those of finished runs, and those of unfinished runs.

    Args:
        patterns: paths of runs; may contain ``*``.

    Raises:
        InputError: there is no pattern, or one names no finished run.
    """
    if not patterns:
        raise InputError("runs", "name no fit", "give folders of finished fits, or patterns")
    finished: set[Path] = set()
    unfinished: set[Path] = set()
    for pattern in patterns:
        folders = [path for path in matching_paths(pattern) if path.is_dir()]
        finished_here = {folder for folder in folders if (folder / DONE).is_file()}
        if not finished_here:
            raise InputError(pattern, "names no finished run", "fit first, or correct the pattern")
        finished |= finished_here
        unfinished |= set(folders) - finished_here
    return sorted(finished), sorted(unfinished)


def finished_fits(patterns: Sequence[str]) -> list[Path]:
    """Folders of finished fits that match patterns.

    Args:
        patterns: as `finished_runs` takes them.

    Raises:
        InputError: a pattern names no finished run, or a run has no renders of held-out views.
    """
    fits = finished_runs(patterns)[0]
    for run in fits:
        refuse_without_views(run)
    return fits


def refuse_frozen_fits(fits: Sequence[Path], purpose: str) -> None:
    """Refuse fits of test scenes, by the folder's name or by the scene that the fit's records state.

    Args:
        fits: folders of finished fits.
        purpose: the refused use, as a participle for the error message.

    Raises:
        InputError: a fit is of a test scene.
    """
    refuse_frozen(fits, purpose)
    for fit in fits:
        if is_frozen(f"{scene_of(fit)}-"):
            received = f"is of the frozen test scene {scene_of(fit)}: nothing may be {purpose} it"
            raise InputError(fit, received, "name training or validation runs (docs/data.md)")


def refuse_without_views(run: Path) -> None:
    """Refuse a run without renders of held-out views.

    Raises:
        InputError: it has none.
    """
    if not run_steps(run):
        raise InputError(run, "holds no renders of held-out views", "name folders of finished fits")


def scene_of(run: Path) -> str:
    """The scene of a fit: from its records, else from its folder's name, SCENE-METHOD-DIGEST.

    Raises:
        InputError: the folder has neither records nor a name of this form, or its records are damaged.
    """
    source = run / "records.jsonl"
    if source.is_file() and (records := read_records(source)):
        return records[0].scene
    parts = run.name.rsplit("-", 2)
    if len(parts) != 3 or not all(parts):
        raise InputError(run, "is not named SCENE-METHOD-DIGEST", "name runs of `gaussian-enhancer fit`")
    return parts[0]


def fits_by_scene(fits: Sequence[Path]) -> dict[str, Path]:
    """Index fits by their scene.

    Raises:
        InputError: two are of one scene.
    """
    by_scene: dict[str, Path] = {}
    for fit in fits:
        scene = scene_of(fit)
        if scene in by_scene:
            raise InputError(fit, f"is of the scene {scene}, as {by_scene[scene]} is", "name one fit of each scene")
        by_scene[scene] = fit
    return by_scene
