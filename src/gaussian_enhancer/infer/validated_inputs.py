"""Validate the input of a scene (cameras, depth, references, fine photos) and state what cannot be used, and why."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch

from gaussian_enhancer.align.alignment import LoadedView, Reprojected
from gaussian_enhancer.align.coarse_visibility import coarsen
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.plan import PlanItem, Rules, ViewPlan
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.scene.neighbours import choose_references
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.types import usable_depth

DEPTH_FACTORS = (0.001, 0.01, 0.1, 0.5, 2.0, 10.0, 100.0, 1000.0)
"""Factors by which depth is multiplied to test its scale."""
BETTER_RATIO = 0.9
"""Depth is refused if the colour difference through another depth is below this ratio of its own.

For six training fits of all families and methods, the difference through a plane is 1.15 to 2.1 times that through the
splat's depth, and 0.70 to 0.89 times that through inverse depth.
"""

LEAST_SHARE = 0.1
"""Share of the render that references must show to test the depth by them."""

NOT_GIVEN, SWITCHED_OFF = "not given", "switched off"
NONE_REQUESTED = "none are asked for: views are enhanced from their renders alone"


@dataclass(frozen=True)
class ValidatedInputs:
    """The part of a scene's input that can be used.

    Args:
        rendered: the set without the parts that cannot be used.
        reference_config: how references are chosen and aligned, as far as the input allows.
        parts: which parts are used, and why others are not.
        pool: the set's references; the last ones that were read for validation are in memory.
        unreached: names of the targets to which no reference can be warped, if there are other targets to which
            references can be warped.
    """

    rendered: RenderedSet
    reference_config: ReferenceConfig
    parts: tuple[PlanItem, ...]
    pool: ReferencePool
    unreached: tuple[str, ...] = ()

    def planner(self, rules: Rules, existing_plans: Iterable[ViewPlan] = ()) -> Planner | None:
        """The planner of the views; None if nothing may be left out and every view can have references.

        Args:
            rules: what may be left out.
            existing_plans: plans of views that were made before.
        """
        if rules.full and not self.unreached:
            return None
        return Planner(rules, self.reference_config, self.rendered, existing_plans, self.pool)

    @property
    def missing_references(self) -> tuple[str, ...]:
        """Reasons why references or their fine photos are not used although the weights require them."""
        unused = (part for part in self.parts if not part.used and part.name in ("references", "fine photos"))
        return tuple(part.why for part in unused if part.why != NONE_REQUESTED)


def validate_inputs(
    rendered: RenderedSet,
    reference_config: ReferenceConfig,
    rules: Rules,
    scale: int = 1,
    pool: ReferencePool | None = None,
    origins: Mapping[str, str] = {},
) -> ValidatedInputs:
    """Remove the parts of the input that cannot be used.

    Args:
        rendered: targets and references.
        reference_config: how references were chosen and aligned in training.
        rules: with ``depth`` "auto", depth that does not fit the renders is left out. With ``references`` "auto",
            references without a camera are left out if others have one.
        scale: resolution of the enhanced images relative to the renders'.
        pool: the set's references, some of which may be in memory; None creates a pool.
        origins: sources of "cameras" and "depth" that the user did not give, or the reasons why there are none.

    Raises:
        InputError: references are required, but the set has no photo.
    """
    if reference_config.references and not rendered.references:
        remedy = "add scene=capture scene.path=FOLDER, or max_references=0 to enhance from the renders only"
        raise InputError(rendered.name, "has no photo to refer to", remedy)
    resolution = f"{scale} times the render's size" if scale > 1 else "the weights enhance at the render's own size"
    parts = [PlanItem("super-resolution", scale > 1, resolution)]
    unposed: list[str] = []
    if rules.references == "auto":
        rendered, unposed = _with_cameras(rendered)
    if pool is None or pool.views is not rendered.references:
        pool = ReferencePool(rendered.references)
    rendered, depth = _depth_part(rendered, reference_config, rules, pool, origins.get("depth", ""))
    if rendered.references is not pool.views:
        pool = ReferencePool(rendered.references)
    parts += [_camera_part(rendered, origins.get("cameras", "")), depth]
    wants_references, wants_fine = bool(reference_config.references), reference_config.fine
    if wants_fine:
        fine = all(view.read_fine_photo is not None for view in rendered.references)
        reference_config = replace(reference_config, fine=fine)
    reference_config, references = _reference_part(rendered, reference_config, depth)
    if wants_fine and reference_config.references:
        missing = "no photos of 4 times the renders' resolution: super-resolution without their detail"
        parts.append(PlanItem("fine photos", reference_config.fine, "" if reference_config.fine else missing))
    if unposed and wants_references:
        left_out = f"; {len(unposed)} without a camera left out, {unposed[0]} among them"
        references = replace(references, why=references.why + left_out)
    parts.append(references)
    targets = rendered.targets if reference_config.references else ()
    unreached = tuple(view.name for view in targets if not reference_config.can_align(view))
    return ValidatedInputs(rendered, reference_config, tuple(parts), pool, unreached)


def depth_mismatch_reason(pool: ReferencePool, reference_config: ReferenceConfig, views: Sequence[RenderedView]) -> str:
    """Reason why depth does not fit the renders; empty if it fits, or if this cannot be tested.

    The renders of the two nearest references are warped to each view on a coarse grid: through the depth, through the
    depth times each of `DEPTH_FACTORS`, and through a plane at its median. If one of the alternatives agrees clearly
    better with the render in every view, the depth has another scale, or is another quantity such as inverse depth. An
    alternative counts only if it loses no reference, since a reference from the same place agrees at every depth.

    Args:
        pool: the references.
        reference_config: how references are warped.
        views: targets with cameras and depth.
    """
    better, warp, empty = "", reference_config.warp, []
    for view in views:
        target = read_target(view)
        if target.depth is None or not bool(usable_depth(target.depth).any()):
            empty.append(target.name)  # the view may look past the splat
            continue
        has_cameras = all(posed.camera is not None for posed in (view, *pool.views))
        if not isinstance(warp, Reprojected) or not pool.views or not has_cameras:
            continue
        nearest = choose_references(view, pool.views, 2)
        if not nearest:  # the view's own photo is the only one
            continue
        references = [replace(coarsen(pool.read(index)), depth=None) for index in nearest]
        coarse_target = coarsen(target)
        if coarse_target.depth is None or not bool(usable_depth(coarse_target.depth).any()):
            continue
        median = float(coarse_target.depth[usable_depth(coarse_target.depth)].median())
        alternatives = {f"{factor:g} times as deep": coarse_target.depth * factor for factor in DEPTH_FACTORS}
        alternatives["a flat plane"] = torch.full_like(coarse_target.depth, median)
        disagreement, visible = _colour_disagreement(warp, coarse_target, references)
        smaller = []
        for name, z in alternatives.items():
            other, visible_there = _colour_disagreement(warp, replace(coarse_target, depth=z), references)
            if other < BETTER_RATIO * disagreement and visible <= visible_there:
                smaller.append((other, name))
        if not smaller:
            return ""  # one view that the depth fits is enough
        better = better or min(smaller)[1]
    if empty and len(empty) == len(views):
        return f"the depth of {empty[0]} holds no finite positive value"
    return f"the depth is none of what the renders show ({better} fits better)" if better else ""


def _colour_disagreement(
    warp: Reprojected, target: LoadedView, references: Sequence[LoadedView]
) -> tuple[float, frozenset[str]]:
    """Mean colour difference of warped references to the render, and the names of those that show a tenth of it.

    The difference is infinite if all together show less than a tenth.
    """
    # Renders already have the target's exposure, so that colours are only matched where photos stand in for them.
    match_colour = warp.match_colour and any(reference.render is None for reference in references)
    fixed_depth_warp = replace(warp, depth="exact", photo_consistency=None, match_colour=match_colour)
    aligned = fixed_depth_warp(target, references, len(references))
    colours = aligned.references if aligned.renders is None else aligned.renders
    difference = (colours - target.image).abs().mean(1, keepdim=True) * aligned.visibility
    shares = zip(aligned.names, aligned.visibility.mean((1, 2, 3)), strict=True)
    visible = frozenset(name for name, share in shares if share >= LEAST_SHARE)
    if float(aligned.visibility.amax(0).mean()) < LEAST_SHARE:
        return float("inf"), visible
    return float(difference.sum() / aligned.visibility.sum()), visible


def _with_cameras(rendered: RenderedSet) -> tuple[RenderedSet, list[str]]:
    """The set without the references that lack a camera, if others have one, and the names of those left out."""
    posed = tuple(view for view in rendered.references if view.camera is not None)
    if not posed or len(posed) == len(rendered.references):
        return rendered, []
    return replace(rendered, references=posed), [view.name for view in rendered.references if view.camera is None]


def _camera_part(rendered: RenderedSet, origin: str) -> PlanItem:
    unposed = [view.name for view in (*rendered.targets, *rendered.references) if view.camera is None]
    missing = f"{len(unposed)} views have none, {unposed[0]} first" if unposed else ""
    if len(unposed) == 1:
        missing = f"{unposed[0]} has none"
    posed = any(view.camera is not None for view in rendered.targets) and bool(rendered.references)
    posed = posed and all(view.camera is not None for view in rendered.references)
    return PlanItem("cameras", not unposed or posed, "; ".join(filter(None, (origin, missing))))


def _depth_part(
    rendered: RenderedSet, reference_config: ReferenceConfig, rules: Rules, pool: ReferencePool, origin: str
) -> tuple[RenderedSet, PlanItem]:
    """The set, without depth if depth is not used, and the plan's item on depth."""
    kind = reference_config.warp.depth if isinstance(reference_config.warp, Reprojected) else "as given"
    with_depth = [view for view in rendered.targets if view.read_depth is not None]
    if not with_depth:
        return rendered, PlanItem("depth", False, origin or NOT_GIVEN)
    why = SWITCHED_OFF if rules.depth == "none" else ""
    if rules.depth == "auto" and not rendered.own_depth:
        why = depth_mismatch_reason(pool, reference_config, with_depth[:: max(1, (len(with_depth) + 1) // 2)][:2])
    if not why:
        return rendered, PlanItem("depth", True, origin or kind)
    targets, references = (
        tuple(replace(view, read_depth=None) for view in views) for views in (rendered.targets, rendered.references)
    )
    return replace(rendered, targets=targets, references=references), PlanItem("depth", False, why)


def _reference_part(
    rendered: RenderedSet, reference_config: ReferenceConfig, depth: PlanItem
) -> tuple[ReferenceConfig, PlanItem]:
    """The reference configuration, without references if none can be warped, and the plan's item on references.

    Args:
        rendered: targets and references.
        reference_config: how references are chosen and aligned.
        depth: the plan's item on depth.
    """
    if not reference_config.references:
        return reference_config, PlanItem("references", False, NONE_REQUESTED)
    text = f"{len(rendered.references)} photos, at most {reference_config.references} a view"
    if not isinstance(reference_config.warp, Reprojected):
        return reference_config, PlanItem("references", True, text)
    unreached = [view.name for view in rendered.targets if not reference_config.can_align(view)]
    unposed = [view.name for view in rendered.references if view.camera is None]
    if not unposed and len(unreached) < len(rendered.targets):
        note = f"; none for {len(unreached)} views without camera or depth" if unreached else ""
        return reference_config, PlanItem("references", True, text + note)
    reason = f"{(unreached + unposed)[0]} has no camera or no depth"
    if not depth.used and depth.why != NOT_GIVEN:
        reason = "depth is switched off" if depth.why == SWITCHED_OFF else depth.why
    why = f"{reason}, so that photos cannot be reprojected: no photo is used"
    return replace(reference_config, references=0), PlanItem("references", False, why)
