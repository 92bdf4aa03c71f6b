"""Enhancement of two splats of the same capture, whose enhanced views are averaged.

Fits of the same photos from different random numbers err differently, so that errors partly cancel in the mean of their
renders, and of their enhanced views.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import torch
from omegaconf import DictConfig

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import EnhancedView, SetEnhancer
from gaussian_enhancer.infer.plan import Rules
from gaussian_enhancer.infer.validated_inputs import ValidatedInputs
from gaussian_enhancer.runs.inputs import Task
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.types import Camera


def second_configuration(cfg: DictConfig) -> DictConfig:
    """The configuration that enhances the second splat alone: ``second`` in place of ``run`` or ``gaussians``.

    Args:
        cfg: configuration of the job ``enhance`` with ``second``.

    Raises:
        InputError: there is no first splat, or an option cannot be used with two splats.
    """
    form = first_form(cfg.run, cfg.gaussians)
    single = {"distil": cfg.distil, "budget_ms": cfg.budget_ms, "runtime.processes": cfg.runtime.processes > 1}
    name = next((name for name, value in single.items() if value), None)
    if name is not None:
        raise InputError("second", f"comes with {name}, which is for one splat", f"leave out {name} or second")
    second = cfg.copy()
    second.update({form: str(cfg.second), "second": None})
    return second


def first_form(run: str | Path | None, gaussians: str | Path | None) -> str:
    """The option that names the first splat, "run" or "gaussians"; the second one is of the same form.

    Raises:
        InputError: neither is given.
    """
    if run is None and gaussians is None:
        raise InputError("second", "comes without a first splat", "give run=FOLDER, or gaussians=FILE with scene=...")
    return "gaussians" if run is None else "run"


def refuse_other_views(first: RenderedSet, second: RenderedSet) -> None:
    """Refuse a second splat whose targets are not those of the first.

    Args:
        first: targets and references of the first splat.
        second: those of the second one.

    Raises:
        InputError: number, names, order or cameras of the targets differ.
    """
    names = [tuple(view.name for view in rendered.targets) for rendered in (first, second)]
    if names[0] != names[1]:
        other = min(set(names[0]) ^ set(names[1]), default="in another order")
        raise InputError("second", f"has other views than the first splat, {other}", "fit both with the same split")
    for one, other_view in zip(first.targets, second.targets, strict=True):
        if not _same_camera(one.camera, other_view.camera):
            raise InputError("second", f"has another camera for {one.name}", "give two splats of one capture")


def _same_camera(camera: Camera | None, other: Camera | None) -> bool:
    """Whether both cameras have the same image size and pose, as far as they are known."""
    if camera is None or other is None:
        return camera is other
    same_pose = torch.allclose(camera.world_to_camera.float(), other.world_to_camera.float(), rtol=1e-4, atol=1e-5)
    return same_pose and (camera.height, camera.width) == (other.height, other.width)


def averaged_with(
    views: Iterable[EnhancedView], second: tuple[SetEnhancer, Task, ValidatedInputs], rules: Rules
) -> Iterator[EnhancedView]:
    """The mean of enhanced views of the first splat and those of the second one (`mean_views`).

    Args:
        views: enhanced views of the first splat.
        second: what `prepare_enhancement` returns for the second one.
        rules: what the plan may leave out.
    """
    enhancer, task, validated = second
    return mean_views(views, enhancer(task.rendered, validated.planner(rules), validated.pool))


def mean_views(first: Iterable[EnhancedView], second: Iterable[EnhancedView]) -> Iterator[EnhancedView]:
    """The mean of each two enhanced views, with the sum of their times. The rest is that of the first.

    Args:
        first: enhanced views of a splat.
        second: the same views of another splat.
    """
    for one, other in zip(first, second, strict=True):
        yield replace(
            one,
            image=(one.image + other.image) / 2,
            preparing=one.preparing + other.preparing,
            enhancing=one.enhancing + other.enhancing,
            unchanged=False,
        )
