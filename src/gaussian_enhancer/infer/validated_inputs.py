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
from gaussian_enhancer.scene.neighbours import rank_references
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.types import usable_depth

DEPTH_FACTORS = (0.1, 0.5, 2.0, 10.0)
"""Factors: a depth is doubted where the depth times one of them agrees clearly better with the renders."""
BETTER_RATIO = 0.9
"""A depth is doubted where another one's disagreement is below this share of its own.

Of six training fits of all families and methods, the plane's is 1.15 to 2.1 times that through the splat's depth and
0.70 to 0.89 times that through inverse depth.
"""


@dataclass(frozen=True)
class ValidatedInputs:
    """The part of a scene's input that can be used.

    Args:
        rendered: the set without what cannot be used.
        reference_config: how references are chosen and aligned, as far as the input allows.
        parts: which parts are used, and why others are not.
        pool: the set's references; those that were read for validation are in memory.
        unreached: names of the targets that no reference can be warped to, while others have references.
    """

    rendered: RenderedSet
    reference_config: ReferenceConfig
    parts: tuple[PlanItem, ...]
    pool: ReferencePool
    unreached: tuple[str, ...] = ()

    def planner(self, rules: Rules, existing_plans: Iterable[ViewPlan] = ()) -> Planner | None:
        """The planner of the views; None where nothing may be left out and every view can have references.

        Args:
            rules: what may be left out.
            existing_plans: plans of views that were made before.
        """
        if rules.full and not self.unreached:
            return None
        return Planner(rules, self.reference_config, self.rendered, existing_plans, self.pool)

    @property
    def missing_references(self) -> tuple[str, ...]:
        """Reasons why references or their fine photos are not used although the weights ask for them."""
        return tuple(one.why for one in self.parts if not one.used and one.name in ("references", "fine photos"))


def validate_inputs(
    rendered: RenderedSet,
    reference_config: ReferenceConfig,
    rules: Rules,
    scale: int = 1,
    pool: ReferencePool | None = None,
    origins: Mapping[str, str] = {},
) -> ValidatedInputs:
    """Leave out of the input what cannot be used.

    Args:
        rendered: targets and references.
        reference_config: how references were chosen and aligned in training.
        rules: with ``depth`` "auto", depth that does not fit the renders is left out. With ``references`` "auto",
            references without a camera are left out where others have one.
        scale: how many times finer the enhanced images are than the renders.
        pool: the set's references, where some are in memory already.
        origins: where "cameras" and "depth" come from that were not given, or why there are none.

    Raises:
        InputError: there is no photo to refer to where references are asked for.
    """
    if reference_config.references and not rendered.references:
        remedy = "add scene=capture scene.path=FOLDER, or max_references=0 to enhance from the renders only"
        raise InputError(rendered.name, "has no photo to refer to", remedy)
    finer = f"{scale} times the render's size" if scale > 1 else "the weights enhance at the render's own size"
    parts = [PlanItem("super-resolution", scale > 1, finer)]
    bare: list[str] = []
    if rules.references == "auto":
        rendered, bare = _with_cameras(rendered)
    if pool is None or pool.views is not rendered.references:
        pool = ReferencePool(rendered.references)
    rendered, depth = _depth_part(rendered, reference_config, rules, pool, origins.get("depth", ""))
    if rendered.references is not pool.views:
        pool = ReferencePool(rendered.references)
    parts += [_camera_part(rendered, origins.get("cameras", "")), depth]
    if reference_config.fine:
        fine = all(view.read_fine_photo is not None for view in rendered.references)
        why = "" if fine else "no photos of 4 times the renders' resolution: super-resolution without their detail"
        reference_config = replace(reference_config, fine=fine)
        parts.append(PlanItem("fine photos", fine, why))
    if reference_config.references:
        reference_config, references = _reference_part(rendered, reference_config)
        left = f"; {len(bare)} without a camera left out, {bare[0]} among them" if bare else ""
        parts.append(replace(references, why=references.why + left))
    apart = tuple(view.name for view in rendered.targets if not reference_config.can_align(view))
    unreached = apart if reference_config.references else ()
    return ValidatedInputs(rendered, reference_config, tuple(parts), pool, unreached)


def depth_mismatch_reason(pool: ReferencePool, reference_config: ReferenceConfig, views: Sequence[RenderedView]) -> str:
    """Reason why depth does not fit the renders; empty where it does, or where that cannot be judged.

    The renders of the two nearest references are warped to each view on a coarse grid: through the depth, through the
    depth times each of `DEPTH_FACTORS`, and through a plane at its median. Where one of the others agrees clearly
    better with the render in every view, the depth has another scale, or is another quantity such as inverse depth.

    Args:
        pool: the references.
        reference_config: how they are warped.
        views: targets with cameras and depth.
    """
    better, warp = "", reference_config.warp
    for view in views:
        target = read_target(view)
        if target.depth is None or not bool(usable_depth(target.depth).any()):
            return f"the depth of {target.name} holds no finite positive value"
        bare = any(one.camera is None for one in (view, *pool.views))
        if not isinstance(warp, Reprojected) or not pool.views or bare:
            continue
        near = rank_references(view, pool.views, 2)
        references = [replace(coarsen(pool.read(index)), depth=None) for index in near]
        small = coarsen(target)
        if small.depth is None or not bool(usable_depth(small.depth).any()):
            continue
        median = float(small.depth[usable_depth(small.depth)].median())
        others = {f"{times:g} times as deep": small.depth * times for times in DEPTH_FACTORS}
        others["a flat plane"] = torch.full_like(small.depth, median)
        differences = _colour_disagreement(warp, small, references)
        best = min(
            (_colour_disagreement(warp, replace(small, depth=z), references), name) for name, z in others.items()
        )
        if best[0] >= BETTER_RATIO * differences:
            return ""  # one view that it fits is enough, and the others need not be looked at
        better = better or best[1]
    return f"the depth is none of what the renders show ({better} fits better)" if better else ""


def _colour_disagreement(warp: Reprojected, target: LoadedView, references: Sequence[LoadedView]) -> float:
    """Mean colour difference of warped references to the render; infinite where they see less than a tenth of it."""
    exposed = any(reference.render is None for reference in references)  # renders are of the target's exposure as it is
    doubting = replace(warp, depth="exact", photo_consistency=None, match_colour=warp.match_colour and exposed)
    aligned = doubting(target, references, len(references))
    colours = aligned.references if aligned.renders is None else aligned.renders
    difference = (colours - target.image).abs().mean(1, keepdim=True) * aligned.visibility
    if float(aligned.visibility.amax(0).mean()) < 0.1:
        return float("inf")
    return float(difference.sum() / aligned.visibility.sum())


def _with_cameras(rendered: RenderedSet) -> tuple[RenderedSet, list[str]]:
    """The set without references that have no camera where others have one, and their names."""
    bare = [view.name for view in rendered.references if view.camera is None]
    if not bare or len(bare) == len(rendered.references):
        return rendered, []
    return replace(rendered, references=tuple(v for v in rendered.references if v.camera is not None)), bare


def _camera_part(rendered: RenderedSet, origin: str) -> PlanItem:
    bare = [view.name for view in (*rendered.targets, *rendered.references) if view.camera is None]
    lack = f"{bare[0]} has none" if len(bare) == 1 else f"{len(bare)} views have none, {bare[0]} first" if bare else ""
    posed = any(view.camera is not None for view in rendered.targets) and bool(rendered.references)
    posed = posed and all(view.camera is not None for view in rendered.references)
    return PlanItem("cameras", not bare or posed, "; ".join(filter(None, (origin, lack))))


def _depth_part(
    rendered: RenderedSet, reference_config: ReferenceConfig, rules: Rules, pool: ReferencePool, origin: str
) -> tuple[RenderedSet, PlanItem]:
    """The set without depth where depth is not used, and the plan's part on depth."""
    kind = reference_config.warp.depth if isinstance(reference_config.warp, Reprojected) else "as given"
    with_depth = [view for view in rendered.targets if view.read_depth is not None]
    if not with_depth:
        return rendered, PlanItem("depth", False, "not given")
    why = "switched off" if rules.depth == "none" else ""
    if rules.depth == "auto" and not rendered.own_depth:
        why = depth_mismatch_reason(pool, reference_config, with_depth[:: max(1, (len(with_depth) + 1) // 2)][:2])
    if not why:
        return rendered, PlanItem("depth", True, origin or kind)
    targets, references = (
        tuple(replace(view, read_depth=None) for view in side) for side in (rendered.targets, rendered.references)
    )
    return replace(rendered, targets=targets, references=references), PlanItem("depth", False, why)


def _reference_part(rendered: RenderedSet, reference_config: ReferenceConfig) -> tuple[ReferenceConfig, PlanItem]:
    """The reference configuration, without references where they cannot be warped, and the plan's part on them."""
    text = f"{len(rendered.references)} photos, at most {reference_config.references} a view"
    if not isinstance(reference_config.warp, Reprojected):
        return reference_config, PlanItem("references", True, text)
    unreached = [view.name for view in rendered.targets if not reference_config.can_align(view)]
    bare = [view.name for view in rendered.references if view.camera is None]
    if not bare and len(unreached) < len(rendered.targets):
        left = f"; none for {len(unreached)} views without camera or depth" if unreached else ""
        return reference_config, PlanItem("references", True, text + left)
    lack = f"{(unreached + bare)[0]} has no camera or no depth, so that photos cannot be reprojected"
    return replace(reference_config, references=0), PlanItem("references", False, f"{lack}: no photo is used")
