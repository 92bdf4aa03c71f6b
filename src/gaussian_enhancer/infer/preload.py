"""Reading of all input before anything is written, so that damaged files are found first."""

from collections.abc import Callable, Iterable
from functools import partial

from torch import Tensor

from gaussian_enhancer.align.references import read_target
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.validated_inputs import ValidatedInputs
from gaussian_enhancer.scene.depth_files import ReadDepth
from gaussian_enhancer.scene.posed import ReadCoverage, ReadPhoto
from gaussian_enhancer.scene.rendered import RenderedView


def validation_reads(
    inputs: ValidatedInputs, planner: Planner | None, *, keep_photos: bool = False, render_splat: bool = False
) -> list[Callable[[], object]]:
    """The reads that find damaged files before the first image is written.

    Targets are planned as they are read. Their candidate references are read, and the last ones read stay in memory;
    other references are not read. Targets that are rendered from a splat are planned when they are enhanced, unless
    ``render_splat`` is set.

    Args:
        inputs: the validated input.
        planner: plans each target; None if nothing may be left out.
        keep_photos: whether the targets' own photos are read as well.
        render_splat: also render and plan the targets of a splat.

    Returns:
        Functions without arguments; each raises `InputError` where a file is damaged.
    """
    reads: list[Callable[[], object]] = []
    for view in inputs.rendered.targets:
        if isinstance(view.read, ReadPhoto) or (planner is not None and render_splat):
            reads.append(partial(_plan_and_read, inputs, view, planner))
        else:
            reads += _file_readers([view.read_depth, view.read_alpha])
        reads += _file_readers([view.read_photo, view.read_fine_photo]) if keep_photos else []
    any_from_splat = any(not isinstance(view.read, ReadPhoto) for view in inputs.rendered.targets)
    for view in inputs.rendered.references if any_from_splat and inputs.reference_config.references else ():
        reads += _file_readers([view.read_photo, view.read_depth, view.read, view.read_fine_photo])
    return reads


def _plan_and_read(inputs: ValidatedInputs, view: RenderedView, planner: Planner | None) -> None:
    """Read a target, plan it, and read its candidate references."""
    target = read_target(view)
    plan = None if planner is None else planner(view, target)
    if plan is not None and plan.regions == ():
        return
    chosen = None if planner is None or plan is None else planner.reference_indices(plan)
    for index in inputs.reference_config.nearest_candidates(target, view, inputs.pool) if chosen is None else chosen:
        inputs.pool.read(index, inputs.reference_config.fine)


def _file_readers(reads: Iterable[Callable[[], Tensor] | None]) -> list[Callable[[], Tensor]]:
    return [read for read in reads if isinstance(read, ReadPhoto | ReadDepth | ReadCoverage)]
