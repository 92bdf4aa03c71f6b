"""Choice of the earlier step of a fit whose renders are used as well (`infer.earlier_step`).

A run holds renders of several steps, and a result folder of the original 3DGS the splats of several iterations.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from omegaconf import DictConfig

from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import Pretrained, load_weights
from gaussian_enhancer.scene.renders import choose_step, run_steps
from gaussian_enhancer.splat.io.result_folders import ITERATION

PREFERRED_SHARE = 0.2
"""Preferred share of a run's steps after which the earlier renders were made."""
MIN_STEP = 3000
"""Least step that is chosen automatically. With the renders of step 999, more blocks lose more than 0.5 dB."""


EarlierStep = int | Literal["auto"] | None
"""An earlier step of a run; "auto" chooses one if it can, None uses none."""


def choose_earlier_step(
    earlier: EarlierStep,
    run: str | Path | None,
    gaussians: str | Path | None,
    step: int | None,
    single: Mapping[str, bool],
) -> int | None:
    """The step whose renders are used as well.

    Args:
        earlier: the step, or "auto" for the one nearest to `PREFERRED_SHARE` of the step that is enhanced, from
            `MIN_STEP` on.
        run: a fitted run's folder, if that is the input.
        gaussians: a splat's file or result folder, if that is the input.
        step: for a run: the step that is enhanced; None is the latest.
        single: whether options are set that are for one step, by name.

    Returns:
        The step; None if none is wanted, or "auto" cannot choose one.

    Raises:
        InputError: the run cannot be read; or a step is given beside an option that is for one step, or the input has
            no such step.
    """
    name = next((name for name, is_set in single.items() if is_set), None)
    if earlier is None or (earlier == "auto" and name is not None):
        return None
    if name is not None:
        raise InputError("earlier_step", f"comes with {name}", "leave out one of them")
    if run is not None:
        folder = Path(run)
        last = choose_step(folder, step)
        steps = [other for other in run_steps(folder) if other < last]
    else:
        *steps, last = sorted(splats_by_step(gaussians)) or [0]
    if earlier == "auto":
        candidates = [other for other in steps if other >= MIN_STEP]
        return min(candidates, key=lambda other: abs(other - PREFERRED_SHARE * last), default=None)
    if earlier not in steps:
        found = ", ".join(map(str, steps)) or "there is none"
        remedy = (
            f"choose a step before the enhanced one, of a run or of a result folder of 3DGS ({found}), auto or null"
        )
        raise InputError("earlier_step", f"is {earlier}", remedy)
    return earlier


def splats_by_step(gaussians: str | Path | None) -> dict[int, Path]:
    """The splats in a result folder of the original 3DGS, by step; of anything else, none.

    Args:
        gaussians: a splat's file or result folder.
    """
    files = () if gaussians is None else Path(gaussians).glob("point_cloud/iteration_*/point_cloud.ply")
    matches = ((ITERATION.fullmatch(file.parent.name), file) for file in files)
    return {int(match[1]): file for match, file in matches if match}


def resolve_earlier_step(cfg: DictConfig) -> DictConfig:
    """A configuration whose ``earlier_step`` is a step or None in place of "auto" (`choose_earlier_step`).

    Args:
        cfg: configuration of the job ``enhance``.

    Raises:
        InputError: a given step cannot be used, or there are no such weights.
    """
    single = {
        "second": cfg.second is not None,
        "distil": cfg.distil,
        "budget_ms": cfg.budget_ms is not None,
        **single_step_options(load_weights(cfg.weights), cfg.max_references),
    }
    resolved = cfg.copy()
    resolved.earlier_step = choose_earlier_step(cfg.earlier_step, cfg.run, cfg.gaussians, cfg.step, single)
    return resolved


def single_step_options(pretrained: Pretrained, max_references: int | None) -> dict[str, bool]:
    """Whether options of an enhancement are for one step, by name.

    Args:
        pretrained: the weights.
        max_references: see `EnhancementOptions`.
    """
    return {
        "weights that do not warp references": not isinstance(pretrained.reference_config.warp, Reprojected),
        "max_references=0": max_references == 0,
    }
