"""Enhancement of the views of a set, one after another.

Axes: b batch, h height, w width, H = scale h, W = scale w, for the network's scale.
"""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.alignment import LoadedView, Reprojected, Unwarped
from gaussian_enhancer.align.depth_normalisation import depth_unit
from gaussian_enhancer.align.exposure import apply_colour
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool, build_network_input, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.change_confidence import ChangeConfidence, apply_shares
from gaussian_enhancer.infer.colour_completion import complete_change
from gaussian_enhancer.infer.empty_areas import restore_empty_areas
from gaussian_enhancer.infer.ensemble import MIN_REFERENCES, mean_change, without_last_reference
from gaussian_enhancer.infer.finite_check import refuse_not_finite
from gaussian_enhancer.infer.plan import ViewPlan
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.reference_cache import ReferenceFeatures
from gaussian_enhancer.infer.regions import cut_pixels
from gaussian_enhancer.infer.super_resolution import limit_finer_scales
from gaussian_enhancer.infer.temporal_smoothing import PreviousChange, smooth_change
from gaussian_enhancer.infer.tiles import enhance_tiled
from gaussian_enhancer.network.cascade import Cascade
from gaussian_enhancer.network.colour_clamping import check_window, clamp_to_references
from gaussian_enhancer.network.network import CachesReferences, Network
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.scene.photos import resize
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.typed import check_value
from gaussian_enhancer.types import Camera, NetworkInput, fastest_dtype, usable_depth


@dataclass(frozen=True)
class EnhancedView:
    """One enhanced view.

    Args:
        name: the render's file name.
        image: enhanced image, the network's scale times as fine as the render, [0, 1].
        preparing: milliseconds for choosing, reading and warping references.
        enhancing: milliseconds for the network.
        references: names of the references that were used, best first; if several regions were enhanced, those of the
            first region.
        plan: which parts were enhanced; None if there was no plan and everything was.
        coverage: sum of the references' visibilities at each pixel of the render; 0 where the plan passes the render
            through. None unless ``keeps_coverage`` of `SetEnhancer` is set.
        unchanged: whether the image is the input render, because no reference is visible in it, or because the splat
            was fitted to this view and the render is closer to its photo than the enhanced image.
    """

    name: str
    image: Float[Tensor, "3 _ _"]
    preparing: float
    enhancing: float
    references: tuple[str, ...]
    plan: ViewPlan | None = None
    coverage: Float[Tensor, "1 _ _"] | None = None
    unchanged: bool = False


class SetEnhancer:
    """Enhances the targets of a set one by one.

    Where references are not warped and a target fits in one tile, each reference is encoded once for all targets.

    Args:
        network: the enhancement network.
        reference_config: how references are chosen and aligned.
        device: where the network runs; None is the CPU.
        precision: precision of the network's convolutions; "auto" is float16 on CUDA devices, bfloat16 on CPUs with
            bfloat16 instructions, and float32 on other CPUs.
        tile: side in render pixels of the tiles that larger images are cut into, a multiple of 16. Tiles of
            super-resolution are twice as large, since it splits its finer scales further itself.
        halo: width in pixels of the border of a tile that is computed and discarded, a multiple of 16.
        strength: share of the network's change that is applied, in [0, 1]; 0 returns the render.
        temporal_smoothing: for frames of a path: share of the change that each target takes over from the previous
            one, in [0, 1) (`smooth_change`). Super-resolution does not support it.
        colour_clamping: side in pixels of a window; each enhanced pixel that a reference sees is clamped to the colours
            of the render and of the warped references in the window around it (`clamp_to_references`). 0 turns clamping
            off. This and the next two options have no effect if references are not warped. In super-resolution they
            limit the change at the render's resolution; finer scales are clamped to the colours at the pixel itself
            (`limit_finer_scales`) if clamping is on.
        colour_completion: where no reference is visible, replace the smooth part of the network's change by the one
            that visible pixels predict (`complete_change`).
        confidence: predicts the shares of the change to apply; None applies all of it.
        ensemble: average the changes with all references and without the least useful one (`mean_change`), which takes
            twice the network's time. It has no effect without a confidence, with fewer than `MIN_REFERENCES`
            references, or if references are not warped.
        pass_through: return the render itself if no reference is visible in a view. A network that was trained with
            references can only guess without any. It has no effect on super-resolution.
        keeps_coverage: also return the coverage of each view by references (`EnhancedView`).

    Raises:
        InputError: precision, strength, temporal_smoothing or colour_clamping is out of range.
    """

    def __init__(
        self,
        network: Network,
        reference_config: ReferenceConfig,
        device: torch.device | None = None,
        precision: str = "auto",
        tile: int = 1024,
        halo: int = 96,
        strength: float = 1.0,
        temporal_smoothing: float = 0.0,
        colour_clamping: int = 3,
        pass_through: bool = False,
        colour_completion: bool = True,
        confidence: ChangeConfidence | None = None,
        keeps_coverage: bool = False,
        ensemble: bool = False,
    ) -> None:
        for name, share in (("strength", strength), ("temporal_smoothing", temporal_smoothing)):
            check_value(share, float, name)
        for name, side in (("colour_clamping", colour_clamping), ("tile", tile), ("halo", halo)):
            check_value(side, int, name)
        if not 0 <= strength <= 1:
            raise InputError("strength", f"is {strength}", "use a number from 0 (the render) to 1")
        if not 0 <= temporal_smoothing < 1:
            raise InputError(
                "temporal_smoothing", f"is {temporal_smoothing}", "use a number from 0 (each view by itself) to below 1"
            )
        if temporal_smoothing and network.scale > 1:
            raise InputError(
                "temporal_smoothing",
                "is for weights at the render's own resolution",
                "choose others, or temporal_smoothing=0",
            )
        if colour_clamping:
            check_window(colour_clamping)
        self.device = torch.device("cpu") if device is None else device
        self.network = network.eval().to(self.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.reference_config = reference_config
        self.dtype = choose_precision(precision, self.device)
        self.tile, self.halo, self.strength, self.temporal_smoothing = tile, halo, strength, temporal_smoothing
        self.colour_clamping, self.pass_through = colour_clamping, pass_through
        self.colour_completion, self.keeps_coverage = colour_completion, keeps_coverage
        self.confidence = None if confidence is None else confidence.eval().to(self.device)
        self.ensemble = ensemble and confidence is not None

    def __call__(
        self,
        rendered: RenderedSet,
        planner: Planner | None = None,
        pool: ReferencePool | None = None,
        features: ReferenceFeatures | None = None,
    ) -> Iterator[EnhancedView]:
        """Enhance each target of a set, in its order.

        A target with the name (without its ending) and the camera of a reference is a view that the splat was fitted
        to. If the fit has converged, photos of other views make such a view worse. Its render is kept where it is
        closer than the enhanced image to the view's own photo.

        Args:
            rendered: targets and references.
            planner: decides which regions and references of a view are left out; None enhances every pixel with the
                references that the reference configuration chooses.
            pool: the set's references, some of which may be in memory; ignored with a planner, which has a pool.
            features: cache of these references' features from an earlier call; no effect if references are warped.

        Raises:
            InputError: a view cannot be read, or lacks the camera or depth that alignment or smoothing needs.
        """
        previous: PreviousChange | None = None
        pool = planner.pool if planner is not None else ReferencePool(rendered.references) if pool is None else pool
        fitted_views: dict[str, int] = {}
        if self.reference_config.references and self.network.scale == 1:
            fitted_views = {Path(view.name).stem: i for i, view in enumerate(pool.views) if view.read_photo is not None}
        for enhanced, target in self._enhance_each(rendered, planner, pool, features):
            reference_index = fitted_views.get(Path(enhanced.name).stem)
            if reference_index is not None and _better_as_rendered(target, enhanced.image, pool, reference_index):
                enhanced = dataclasses.replace(enhanced, image=target.image.clamp(0, 1), unchanged=True)
            if not self.temporal_smoothing or self._cannot_be_smoothed(enhanced, target):
                yield enhanced
                previous = None
                continue
            unchanged = enhanced.unchanged and previous is None
            image, previous = smooth_change(enhanced.image, target, previous, self.temporal_smoothing)
            yield dataclasses.replace(enhanced, image=image, unchanged=unchanged)

    def _enhance_each(
        self,
        rendered: RenderedSet,
        planner: Planner | None,
        pool: ReferencePool,
        features: ReferenceFeatures | None,
    ) -> Iterator[tuple[EnhancedView, LoadedView]]:
        """Enhance each target independently; yield it with the target's pixels."""
        if not rendered.targets:
            raise InputError(rendered.name, "has no render to enhance", "render held-out views first")
        feature_cache = None
        if isinstance(self.network, CachesReferences) and isinstance(self.reference_config.warp, Unwarped):
            feature_cache = ReferenceFeatures(self.network) if features is None else features
        for view in rendered.targets:
            started = time.perf_counter()
            target = read_target(view)
            plan = None if planner is None else planner(view, target)
            if planner is not None and plan is not None and plan.regions is not None:
                yield self._enhance_regions(view, target, planner, plan, started), target
                continue
            chosen_references = None if planner is None or plan is None else planner.reference_indices(plan)
            on_device = target.to_device(self.device)
            aligned = self.reference_config.align(on_device, view, pool, chosen_references)
            aligned_at = time.perf_counter()
            views = build_network_input(on_device, aligned)
            image = self.enhance(views, aligned.names, feature_cache)[0]
            enhanced_at = time.perf_counter()
            milliseconds = 1e3 * (aligned_at - started), 1e3 * (enhanced_at - aligned_at)
            coverage = aligned.visibility.sum(0).cpu() if self.keeps_coverage else None
            yield (
                EnhancedView(
                    view.name, image, *milliseconds, aligned.names, plan, coverage, self._passes_through(views)
                ),
                target,
            )

    def _enhance_regions(
        self, view: RenderedView, target: LoadedView, planner: Planner, plan: ViewPlan, started: float
    ) -> EnhancedView:
        """Enhance the planned regions of a view, each as a separate image; other pixels are those of the render."""
        height, width = plan.size
        scale, chosen_references = self.network.scale, planner.reference_indices(plan)
        scene_depth_unit = None if target.depth is None else depth_unit(target.depth[None])
        image = upsample_bicubic(target.image[None], scale)[0].clamp(0, 1)
        names: tuple[str, ...] = ()
        network_seconds, coverage = 0.0, target.image.new_zeros(1, height, width) if self.keeps_coverage else None
        for region in plan.regions or ():
            grown = region.expand(planner.rules.margin, height, width)
            crop = cut_pixels(target, grown).to_device(self.device)
            aligned = self.reference_config.align(
                crop, dataclasses.replace(view, camera=crop.camera), planner.pool, chosen_references
            )
            aligned_at = time.perf_counter()
            enhanced = self.enhance(build_network_input(crop, aligned, scene_depth_unit), aligned.names)[0]
            network_seconds += time.perf_counter() - aligned_at
            region.crop(image, scale).copy_(region.relative_to(grown).crop(enhanced, scale))
            names = names or aligned.names
            if coverage is not None:
                region.crop(coverage).copy_(region.relative_to(grown).crop(aligned.visibility.sum(0).cpu()))
        preparation_seconds = time.perf_counter() - started - network_seconds
        return EnhancedView(view.name, image, 1e3 * preparation_seconds, 1e3 * network_seconds, names, plan, coverage)

    def _passes_through(self, views: NetworkInput) -> bool:
        """Whether views are returned unchanged, since no reference is visible in them."""
        return self.pass_through and self.network.scale == 1 and not bool((views.visibility > 0).any())

    def _cannot_be_smoothed(self, enhanced_view: EnhancedView, target: LoadedView) -> bool:
        """Whether a view has no camera or depth for smoothing, which the plan permits by using no references."""
        return (
            enhanced_view.plan is not None
            and enhanced_view.plan.references == ()
            and (target.camera is None or target.depth is None)
        )

    @torch.inference_mode()
    def enhance(
        self, views: NetworkInput, names: Sequence[str] = (), reference_features: ReferenceFeatures | None = None
    ) -> Float[Tensor, "b 3 H W"]:
        """Run the network, in tiles where the image is large; the result is on the CPU, in [0, 1].

        Args:
            views: the network's input for the targets.
            names: names of the references, which are keys of the cache.
            reference_features: cache of reference features; no effect if the image needs several tiles.

        Raises:
            InputError: values are not finite or far out of range.
        """
        views = views.to(self.device)
        refuse_not_finite(views)
        if self._passes_through(views):
            return views.render.float().clamp(0, 1).cpu()
        if views.depth is not None and not bool(usable_depth(views.depth).any()):
            views = dataclasses.replace(views, depth=None, depth_unit=None)
        is_warped = isinstance(self.reference_config.warp, Reprojected)
        if reference_features is not None and max(views.render.shape[-2:]) <= self.tile:
            with self._autocast():
                enhanced = reference_features.network(views, reference_features(views, names)).float()
        elif is_warped and isinstance(self.network, Cascade):
            enhanced = self._super_resolve(self.network, views)
        elif is_warped and self.network.scale == 1:
            enhanced = self._run_limited(self.network, views)
        else:
            enhanced = self._run(self.network, views)
        if self.strength < 1:
            upsampled_render = upsample_bicubic(views.render, self.network.scale)
            enhanced = upsampled_render + self.strength * (enhanced - upsampled_render)
        if self.network.scale > 1:  # the result shares no memory with the input
            return enhanced.clamp_(0, 1).cpu()
        return enhanced.clamp(0, 1).cpu()

    def _autocast(self) -> torch.autocast:
        return torch.autocast(self.device.type, self.dtype, enabled=self.dtype != torch.float32)

    def _run(self, network: Network, views: NetworkInput) -> Float[Tensor, "b 3 _ _"]:
        """Run a network, in tiles where the image is large."""
        tile = self.tile if network.scale == 1 else 2 * self.tile
        with self._autocast():
            return enhance_tiled(network, views, tile, self.halo, scale=network.scale).float()

    def _super_resolve(self, cascade: Cascade, views: NetworkInput) -> Float[Tensor, "b 3 H W"]:
        """Enhance at the render's resolution, limit that change, and enhance the result to 4 times the resolution."""
        limited = self._run_limited(cascade.first, dataclasses.replace(views, fine_references=None))
        finer = self._run(cascade.second, dataclasses.replace(views, render=limited))
        return limit_finer_scales(finer, limited, views, clamps=bool(self.colour_clamping))

    def _run_limited(self, network: Network, views: NetworkInput) -> Float[Tensor, "b 3 h w"]:
        """Enhance at the render's resolution, and limit the change."""
        enhanced = self._limit_change(self._run(network, views), views)
        if not self.ensemble or views.references.shape[1] < MIN_REFERENCES:
            return enhanced
        fewer = without_last_reference(views)
        return mean_change(views.render, enhanced, self._limit_change(self._run(network, fewer), fewer))

    def _limit_change(self, enhanced: Float[Tensor, "b 3 h w"], views: NetworkInput) -> Float[Tensor, "b 3 h w"]:
        """Limit the change to a render."""
        if self.colour_clamping:
            enhanced = clamp_to_references(enhanced, views, self.colour_clamping)
        if self.colour_completion:
            enhanced = complete_change(enhanced, views)
        if self.confidence is not None:
            enhanced = apply_shares(enhanced, views.render, self.confidence.shares(enhanced, views))
        return restore_empty_areas(enhanced, views)


def _same_pose(camera: Camera | None, other: Camera | None) -> bool:
    """Whether both cameras are known and have the same pose."""
    if camera is None or other is None:
        return False
    return torch.allclose(camera.world_to_camera.float(), other.world_to_camera.float(), rtol=1e-4, atol=1e-5)


def _better_as_rendered(target: LoadedView, enhanced: Float[Tensor, "3 h w"], pool: ReferencePool, index: int) -> bool:
    """Whether the splat was fitted to a view, and the render has a smaller mean squared error than the enhanced image.

    The error is measured to the view's photo, whose exposure is matched to that of the render.

    Args:
        target: pixels of the render.
        enhanced: the enhanced image.
        pool: references.
        index: index of the reference that has the view's name.
    """
    if not _same_pose(target.camera, pool.views[index].camera):
        return False
    fitted_photo, render = pool.read(index), target.image
    photo = resize(fitted_photo.image, *render.shape[-2:]).to(render)
    if fitted_photo.exposure is not None:
        photo = apply_colour(photo, fitted_photo.exposure.to(photo))
    render_error, enhanced_error = ((image.to(photo) - photo).square().mean() for image in (render, enhanced))
    return bool(render_error < enhanced_error)


def choose_precision(precision: str, device: torch.device) -> torch.dtype:
    """The data type in which convolutions are computed.

    Raises:
        InputError: the name is unknown.
    """
    names = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}
    if precision in names:
        return names[precision]
    if precision != "auto":
        raise InputError("precision", f"is {precision!r}", f"choose auto, {', '.join(names)}")
    return torch.float16 if device.type == "cuda" else fastest_dtype()
