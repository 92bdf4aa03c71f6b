"""What a job enhances is read before it writes: damaged files are found, and what is used stays in memory."""

from collections.abc import Callable, Iterable
from functools import partial

from torch import Tensor

from gaussian_enhancer.align.references import read_target
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.validated_inputs import ValidatedInputs
from gaussian_enhancer.scene.depth_files import ReadDepth
from gaussian_enhancer.scene.posed import ReadCoverage, ReadPhoto
from gaussian_enhancer.scene.rendered import RenderedView


def file_reads(
    found: ValidatedInputs, keep_photos: bool, planner: Planner | None, rendering: bool
) -> list[Callable[[], object]]:
    """All that will be read from files: read once before the first image is written, so that a damaged one is found.

    Targets are planned as they are read, and the references that come into question for them stay in memory; the
    others are not read at all. Targets that are rendered when they are asked for are planned when they are enhanced.

    Args:
        found: targets, references and how they are prepared.
        keep_photos: whether the targets' own photos are looked at.
        planner: decides what of each target is enhanced; None where nothing is left out.
        rendering: plan targets that are rendered, too.
    """
    reads: list[Callable[[], object]] = []
    for view in found.rendered.targets:
        if isinstance(view.read, ReadPhoto) or (planner is not None and rendering):
            reads.append(partial(_look, found, view, planner))
        else:
            reads += _from_files([view.read_depth, view.read_alpha])
        reads += _from_files([view.read_photo, view.read_fine_photo]) if keep_photos else []
    drawn = any(not isinstance(view.read, ReadPhoto) for view in found.rendered.targets)
    for view in found.rendered.references if drawn and found.reference_config.references else ():
        reads += _from_files([view.read_photo, view.read_depth, view.read, view.read_fine_photo])
    return reads


def _look(found: ValidatedInputs, view: RenderedView, planner: Planner | None) -> None:
    """Read a target, plan it where it is to be planned, and read what it may refer to."""
    target = read_target(view)
    plan = None if planner is None else planner(view, target)
    if plan is not None and plan.regions == ():
        return
    chosen = None if planner is None or plan is None else planner.chosen(plan)
    for index in found.reference_config.nearest(target, view, found.pool) if chosen is None else chosen:
        found.pool.read(index, found.reference_config.fine)


def _from_files(reads: Iterable[Callable[[], Tensor] | None]) -> list[Callable[[], Tensor]]:
    return [read for read in reads if isinstance(read, ReadPhoto | ReadDepth | ReadCoverage)]
