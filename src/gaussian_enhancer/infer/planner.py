"""Planning a scene view by view: regions and references.

Axes: i, j blocks of a target.
"""

from collections.abc import Iterable
from dataclasses import replace

import torch.nn.functional as F
from jaxtyping import Bool
from torch import Tensor

from gaussian_enhancer.align.alignment import AlignedReferences, LoadedView, Reprojected
from gaussian_enhancer.align.coarse_visibility import coarse_visibility, coarsen, visible_shares
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool
from gaussian_enhancer.infer.plan import Rules, ViewPlan
from gaussian_enhancer.infer.regions import background_blocks, cover_with_regions
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.types import Region

WHOLE_IMAGE_SHARE = 0.9
"""Share of the image above which regions with their margins cost as much as the whole image."""


class Planner:
    """Decides view by view which regions are enhanced, and with which references.

    Args:
        rules: what may be left out.
        reference_config: how references are chosen and aligned, as far as the input allows.
        rendered: the set that is enhanced.
        existing_plans: plans of views that were made before.
        pool: the set's references, some of which may be in memory; None creates a pool.
    """

    def __init__(
        self,
        rules: Rules,
        reference_config: ReferenceConfig,
        rendered: RenderedSet,
        existing_plans: Iterable[ViewPlan] = (),
        pool: ReferencePool | None = None,
    ) -> None:
        self.rules, self.reference_config, self.background = rules, reference_config, rendered.background
        self.pool = ReferencePool(rendered.references) if pool is None else pool
        self.index = {view.name: number for number, view in enumerate(rendered.references)}
        self.plans = {view.name: view for view in existing_plans}
        self._coarse_references: dict[int, LoadedView] = {}

    def __call__(self, view: RenderedView, target: LoadedView) -> ViewPlan:
        """The plan of a view, which is made once.

        Args:
            view: the target.
            target: pixels of the target.
        """
        if view.name not in self.plans:
            self.plans[view.name] = self._make_plan(view, target)
        return self.plans[view.name]

    def reference_indices(self, plan: ViewPlan) -> tuple[int, ...] | None:
        """The references of a plan as indices into the pool; None leaves the choice to the reference configuration."""
        return None if plan.references is None else tuple(self.index[name] for name in plan.references)

    def _make_plan(self, view: RenderedView, target: LoadedView) -> ViewPlan:
        height, width = target.image.shape[-2:]
        plan, warp = ViewPlan(view.name, (height, width)), self.reference_config.warp
        aligned = needed = None
        if self.reference_config.references and not self.reference_config.can_align(view):
            return replace(plan, references=())
        if self.reference_config.references and not isinstance(warp, Reprojected):
            return plan  # references that are not warped belong to the whole image
        if self.rules.tiles == "auto":
            foreground = ~background_blocks(target.image, self.background, self.rules.tolerance)
            needed = None if bool(foreground.all()) else foreground
        selects = self.rules.references == "auto" and height * width > self.rules.small
        if isinstance(warp, Reprojected) and self.reference_config.references and (needed is not None or selects):
            indices = self.reference_config.nearest_candidates(target, view, self.pool)
            coarse_target = coarsen(target)
            aligned = coarse_visibility(warp, coarse_target, [self._coarse_reference(index) for index in indices])
            if self.rules.references == "auto":
                plan = self._with_references(plan, visible_shares(aligned, coarse_target.alpha))
        return plan if needed is None else replace(plan, regions=self._regions(needed, aligned, height, width))

    def _coarse_reference(self, index: int) -> LoadedView:
        """A reference on the coarse grid, kept in memory."""
        if index not in self._coarse_references:
            self._coarse_references[index] = coarsen(self.pool.read(index, self.reference_config.fine))
        return self._coarse_references[index]

    def _with_references(self, plan: ViewPlan, shares: dict[str, float]) -> ViewPlan:
        """The plan with the best of the candidates that show enough of the target."""
        sufficient = [name for name, share in shares.items() if share >= self.rules.share]
        used = tuple(sufficient[: self.reference_config.references])
        left_out = {name: round(share, 4) for name, share in shares.items() if name not in used}
        return replace(plan, references=used, left_out=left_out)

    def _regions(
        self, needed: Bool[Tensor, "i j"], aligned: AlignedReferences | None, height: int, width: int
    ) -> tuple[Region, ...] | None:
        """The regions to enhance; None if they cost nearly as much as the whole image."""
        if aligned is not None:
            needed = needed | self._contradicted_background(aligned, *needed.shape)
        regions = cover_with_regions(needed, height, width, self.rules.margin)
        cost = sum(region.expand(self.rules.margin, height, width).area for region in regions)
        return None if cost > WHOLE_IMAGE_SHARE * height * width else regions

    def _contradicted_background(
        self, aligned: AlignedReferences, rows: int, columns: int
    ) -> Bool[Tensor, "{rows} {columns}"]:
        """Blocks where a reference shows something that is not the background."""
        colour = aligned.references.new_tensor(self.background)[:, None, None]
        differs = (aligned.references - colour).abs().amax(1) > self.rules.tolerance
        differs &= aligned.visibility[:, 0] > 0.5
        anywhere = differs.any(0).to(aligned.references.dtype)[None]
        return F.adaptive_max_pool2d(anywhere, (rows, columns))[0] > 0
