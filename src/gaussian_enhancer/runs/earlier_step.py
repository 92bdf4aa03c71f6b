"""Enhancement of a fit together with renders of one of its earlier steps (`infer.earlier_step`).

A run holds renders of several steps, and a result folder of the original 3DGS the splats of several iterations.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from omegaconf import DictConfig

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.earlier_step import combine_with_earlier
from gaussian_enhancer.infer.enhancer import EnhancedView, SetEnhancer
from gaussian_enhancer.infer.plan import Rules
from gaussian_enhancer.infer.validated_inputs import ValidatedInputs
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.runs.inputs import Task
from gaussian_enhancer.scene.rendered import RenderedSet
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
    """The step whose renders are enhanced as well.

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
        steps = [other for other in run_steps(folder) if other < last and other in run_steps(folder, "train")]
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
        "runtime.processes": cfg.runtime.get("processes", 1) > 1,
        **single_step_options(cfg.weights, cfg.temporal_smoothing, cfg.max_references),
    }
    resolved = cfg.copy()
    resolved.earlier_step = choose_earlier_step(cfg.earlier_step, cfg.run, cfg.gaussians, cfg.step, single)
    return resolved


def single_step_options(
    weights: str | Path, temporal_smoothing: int | float, max_references: int | None
) -> dict[str, bool]:
    """Whether options of an enhancement are for one step: super-resolution, smoothing over time, and no references.

    Args:
        weights: shipped name or file.
        temporal_smoothing: see `EnhancementOptions`.
        max_references: see `EnhancementOptions`.

    Raises:
        InputError: there are no such weights.
    """
    return {
        f"weights={weights}": load_weights(weights).network.scale > 1,
        "temporal_smoothing": temporal_smoothing > 0,
        "max_references=0": max_references == 0,
    }


def earlier_configuration(cfg: DictConfig) -> DictConfig:
    """The configuration that enhances the renders of the earlier step alone, with one enhancement a view.

    Args:
        cfg: what `resolve_earlier_step` returns, with a step.
    """
    earlier = cfg.copy()
    earlier.update({**earlier_input(cfg.earlier_step, cfg.gaussians), "earlier_step": None, "ensemble": False})
    return earlier


def earlier_input(earlier_step: int, gaussians: str | Path | None) -> dict[str, Any]:
    """The option that selects an earlier step, in place of that of the enhanced one.

    Args:
        earlier_step: what `choose_earlier_step` returns.
        gaussians: the result folder, if the input is one; otherwise it is a run.
    """
    return {"step": earlier_step} if gaussians is None else {"gaussians": str(splats_by_step(gaussians)[earlier_step])}


def combined_with_earlier(
    views: Iterable[EnhancedView],
    rendered: RenderedSet,
    earlier: tuple[SetEnhancer, Task, ValidatedInputs],
    rules: Rules,
) -> Iterator[EnhancedView]:
    """Enhanced views of a fit, combined with those of an earlier step. The times of both are added.

    A view that stays as it was rendered is not changed.

    Args:
        views: enhanced views of the last step.
        rendered: its renders.
        earlier: what `prepare_enhancement` returns for the earlier step.
        rules: what the plan may leave out.
    """
    enhancer, task, validated = earlier
    earlier_views = enhancer(task.rendered, validated.planner(rules), validated.pool)
    renders = zip(rendered.targets, task.rendered.targets, strict=True)
    for view, other, (target, earlier_target) in zip(views, earlier_views, renders, strict=True):
        image = view.image
        if not view.unchanged and target.read is not None and earlier_target.read is not None:
            image = combine_with_earlier(image, other.image, target.read(), earlier_target.read())
        preparing, enhancing = view.preparing + other.preparing, view.enhancing + other.enhancing
        yield replace(view, image=image, preparing=preparing, enhancing=enhancing)
