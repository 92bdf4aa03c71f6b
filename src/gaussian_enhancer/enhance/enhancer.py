"""From a set of renders to enhanced images.

Axes: b batch, h height, w width, H, W the same times the network's scale.
"""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.enhance.alignment import Pixels, Reprojected, Unwarped
from gaussian_enhancer.enhance.cache import ReferenceFeatures
from gaussian_enhancer.enhance.evidence import check_window, within_evidence
from gaussian_enhancer.enhance.finite import refuse_not_finite
from gaussian_enhancer.enhance.modulate import depth_unit
from gaussian_enhancer.enhance.network import Network, Remembering
from gaussian_enhancer.enhance.plan import ViewPlan
from gaussian_enhancer.enhance.planning import Planner
from gaussian_enhancer.enhance.prepare import Pool, Preparation, join, read_target
from gaussian_enhancer.enhance.pyramid import enlarged
from gaussian_enhancer.enhance.regions import cut_pixels
from gaussian_enhancer.enhance.steady import Carried, steadied
from gaussian_enhancer.enhance.tiles import enhance_tiled
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.typed import check_value
from gaussian_enhancer.types import Views, usable


@dataclass(frozen=True)
class Enhanced:
    """One enhanced view.

    Args:
        name: the render's file name.
        image: of the render's size, or finer by the network's scale, [0, 1].
        preparing: milliseconds spent on choosing, reading and warping references.
        enhancing: milliseconds spent in the network.
        references: names of the references that were used, best first; those of the first region that was enhanced.
        plan: what was enhanced of the view; None where everything was.
    """

    name: str
    image: Float[Tensor, "3 _ _"]
    preparing: float
    enhancing: float
    references: tuple[str, ...]
    plan: ViewPlan | None = None


class Enhancer:
    """Enhances the targets of a set one by one.

    Where references are not warped and a target fits in one tile, references are encoded once for all targets.

    Args:
        network: maps views to enhanced images.
        preparation: how references are chosen and aligned.
        device: where the network runs.
        precision: of the network's convolutions; "auto" is bfloat16 on processors and float16 on graphics cards
            that compute in it, float32 elsewhere.
        tile: side of the tiles that larger images are cut into, a multiple of 16.
        halo: pixels around a tile that are computed and thrown away, a multiple of 16.
        strength: share of the network's change that is applied, in [0, 1]; 0 returns the render.
        steady: share of the change that each target takes over from the one before it, in [0, 1): for frames of a path,
            at the render's own resolution (`steadied`).
        evidence: side of the window within whose colours, the render's and the warped references', an enhanced pixel
            stays (`within_evidence`); 0 sets no limit. None is set at finer resolutions, where references are not
            warped, or where there are none.

    Raises:
        InputError: precision, strength, steady or evidence is out of range.
    """

    def __init__(
        self,
        network: Network,
        preparation: Preparation,
        device: torch.device | None = None,
        precision: str = "auto",
        tile: int = 1024,
        halo: int = 96,
        strength: float = 1.0,
        steady: float = 0.0,
        evidence: int = 3,
    ) -> None:
        for name, share in (("strength", strength), ("steady", steady)):
            check_value(share, float, name)
        for name, side in (("evidence", evidence), ("tile", tile), ("halo", halo)):
            check_value(side, int, name)
        if not 0 <= strength <= 1:
            raise InputError("strength", f"is {strength}", "use a number from 0 (the render) to 1")
        if not 0 <= steady < 1:
            raise InputError("steady", f"is {steady}", "use a number from 0 (each view by itself) to below 1")
        if steady and network.scale > 1:
            raise InputError("steady", "is for weights at the render's own resolution", "choose others, or steady=0")
        if evidence:
            check_window(evidence)
        self.device = torch.device("cpu") if device is None else device
        self.network = network.eval().to(self.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.preparation = preparation
        self.dtype = choose_precision(precision, self.device)
        self.tile, self.halo, self.strength, self.steady = tile, halo, strength, steady
        self.evidence = evidence

    def __call__(
        self, rendered: RenderedSet, planner: Planner | None = None, pool: Pool | None = None
    ) -> Iterator[Enhanced]:
        """Enhance each target of a set, in its order.

        Args:
            rendered: targets and references.
            planner: leaves out what a view does not need; None enhances every pixel with every reference.
            pool: the set's references, where some are in memory already; a planner has its own.

        Raises:
            InputError: a view cannot be read, or lacks what the preparation or carrying changes needs.
        """
        before: Carried | None = None
        for one, target in self._each(rendered, planner, pool):
            if not self.steady:
                yield one
                continue
            image, before = steadied(one.image, target, before, self.steady)
            yield dataclasses.replace(one, image=image)

    def _each(
        self, rendered: RenderedSet, planner: Planner | None, pool: Pool | None
    ) -> Iterator[tuple[Enhanced, Pixels]]:
        """Each target enhanced by itself, and its pixels."""
        if not rendered.targets:
            raise InputError(rendered.name, "has no render to enhance", "render held-out views first")
        if planner is not None:
            pool = planner.pool
        elif pool is None:
            pool = Pool(rendered.references)
        kept = None
        if isinstance(self.network, Remembering) and isinstance(self.preparation.warp, Unwarped):
            kept = ReferenceFeatures(self.network)
        for view in rendered.targets:
            started = time.perf_counter()
            target = read_target(view)
            plan = None if planner is None else planner(view, target)
            if planner is not None and plan is not None and plan.regions is not None:
                yield self._in_parts(view, target, planner, plan, started), target
                continue
            chosen = None if planner is None or plan is None else planner.chosen(plan)
            moved = target.on(self.device)
            aligned = self.preparation.align(moved, view, pool, chosen)
            prepared = time.perf_counter()
            image = self.enhance(join(moved, aligned), aligned.names, kept)[0]
            ended = time.perf_counter()
            times = 1e3 * (prepared - started), 1e3 * (ended - prepared)
            yield Enhanced(view.name, image, *times, aligned.names, plan), target

    def _in_parts(
        self, view: RenderedView, target: Pixels, planner: Planner, plan: ViewPlan, started: float
    ) -> Enhanced:
        """A view of which regions are enhanced, each as if it were an image of its own, and the rest passed through."""
        height, width = plan.size
        scale, chosen = self.network.scale, planner.chosen(plan)
        unit = None if target.depth is None else depth_unit(target.depth[None])
        image = enlarged(target.image[None], scale)[0].clamp(0, 1)
        image = image.clone() if scale == 1 else image  # what was read may be kept by its reader
        names: tuple[str, ...] = ()
        enhancing = 0.0
        for region in plan.regions or ():
            seen = region.grown(planner.rules.margin, height, width)
            part = cut_pixels(target, seen).on(self.device)
            aligned = self.preparation.align(part, dataclasses.replace(view, camera=part.camera), planner.pool, chosen)
            prepared = time.perf_counter()
            enhanced = self.enhance(join(part, aligned, unit), aligned.names)[0]
            enhancing += time.perf_counter() - prepared
            region.cut(image, scale).copy_(region.within(seen).cut(enhanced, scale))
            names = names or aligned.names
        preparing = time.perf_counter() - started - enhancing
        return Enhanced(view.name, image, 1e3 * preparing, 1e3 * enhancing, names, plan)

    @torch.inference_mode()
    def enhance(
        self, views: Views, names: Sequence[str] = (), kept: ReferenceFeatures | None = None
    ) -> Float[Tensor, "b 3 H W"]:
        """Run the network, in tiles where the image is large; the result is on the CPU, in [0, 1].

        Args:
            views: what is known of the target.
            names: of the references.
            kept: features of references that are kept between targets; without effect where there are several tiles.
        """
        views = views.to(self.device)
        refuse_not_finite(views)
        if views.depth is not None and not bool(usable(views.depth).any()):
            views = dataclasses.replace(views, depth=None, depth_unit=None)
        with torch.autocast(self.device.type, self.dtype, enabled=self.dtype != torch.float32):
            if kept is not None and max(views.render.shape[-2:]) <= self.tile:
                enhanced = kept.network(views, kept(views, names))
            else:
                enhanced = enhance_tiled(self.network, views, self.tile, self.halo, scale=self.network.scale)
        enhanced = enhanced.float()
        if self.strength < 1:
            start = enlarged(views.render, self.network.scale)
            enhanced = start + self.strength * (enhanced - start)
        warped = isinstance(self.preparation.warp, Reprojected)
        if self.evidence and warped and self.network.scale == 1:
            enhanced = within_evidence(enhanced, views, self.evidence)
        return enhanced.clamp(0, 1).cpu()


def choose_precision(precision: str, device: torch.device) -> torch.dtype:
    """The type that convolutions compute in.

    Raises:
        InputError: the name is unknown.
    """
    names = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}
    if precision in names:
        return names[precision]
    if precision != "auto":
        raise InputError("precision", f"is {precision!r}", f"choose auto, {', '.join(names)}")
    if device.type == "cuda":
        return torch.float16
    # Emulated bfloat16 is slower than float32, so only processors that have it use it.
    return torch.bfloat16 if torch.cpu._is_avx512_bf16_supported() else torch.float32
