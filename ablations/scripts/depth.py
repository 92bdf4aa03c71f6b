"""``gaussian-enhancer depth``: gain with several kinds of depth.

The same weights enhance with references warped through several kinds of depth: the splat's expected depth and its
surface (median depth), each unchanged, after the search for its kind, and smoothed before each search; the surface also
with photos compared with each other in the search; and, in procedural scenes, the exact depth of the world, for target
and references. The candidates are the same for all rows, and the network always sees the stored depth. Two figures
need no network: the PSNR of the best warped reference on the pixels that it shows, and the result of adding the
splat's residuals in the references, render + sum_i w_i (photo_i - render_i) / (sum_i w_i + 0.5) over warped photos and
renders, with w_i = visibility x exp(-|render_i - render| / 0.02) and differences averaged over 5x5 visible pixels.
"""

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd
import torch
import torch.nn.functional as F
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

from ablations.study.engine import Study, job
from ablations.study.enhanced_views import enhanced_views
from ablations.study.fits import finished_fits, scene_of
from ablations.study.rows import with_gains
from gaussian_enhancer.align.alignment import AlignedReferences, LoadedView, Reprojected
from gaussian_enhancer.align.depth_search import DepthKind
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.input_files import read_configuration
from gaussian_enhancer.metrics.image_quality import psnr
from gaussian_enhancer.metrics.lpips import PerceptualDistance, requested_distances
from gaussian_enhancer.metrics.pair import PROTOCOL
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.scene.procedural.source import ProceduralView
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.splat.io.open import read_splat
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.types import Camera, quantise_8_bit

SEARCHED: tuple[tuple[str, str, DepthKind, bool, bool], ...] = (
    ("expected", "expected", "exact", False, False),
    ("expected, searched", "expected", "expected", False, False),
    ("expected, smoothed, searched", "expected", "expected", True, False),
    ("surface", "surface", "exact", False, False),
    ("surface, searched", "surface", "surface", False, False),
    ("surface, smoothed, searched", "surface", "surface", True, False),
    ("surface, smoothed, searched by photos too", "surface", "surface", True, True),
    ("exact", "exact", "exact", False, False),
)
"""Name of a row, which depth it warps through, how that is searched, whether it is smoothed before, and whether photos
are asked to agree with each other."""
FAR = 1e4
"""Distance that the sky, which has no depth, is given: this many times that of everything else."""
SOFTNESS, PRIOR = 0.02, 0.5
"""Of the residuals that are added: difference at which a reference's weight falls to 1/e, and weight of no change."""


Depths = Mapping[str, Float[Tensor, "1 h w"]]
"""Z by the view's name."""


@dataclass(frozen=True, eq=False)  # depths are not compared
class ReplacedDepthWarp:
    """A warp through given depth maps instead of the stored ones.

    Args:
        depths: of targets and references.
        warp: method of the warp.
    """

    depths: Depths
    warp: Reprojected

    def __call__(self, target: LoadedView, references: Sequence[LoadedView], keep: int) -> AlignedReferences:
        """Replace the depths, then warp."""
        views = [replace(view, depth=self.depths[view.name]) for view in (target, *references)]
        return self.warp(views[0], views[1:], keep)


def depths_of(run: Path, rendered: RenderedSet) -> dict[str, Depths]:
    """Every kind of depth of a run's views: rendered from its splat and, for procedural scenes, exact."""
    splat = read_configuration(run / "config.yaml").get("splat")
    if not isinstance(splat, dict):
        raise InputError(run / "config.yaml", "names no splat", "give runs of the job fit")
    gaussians, method = read_splat(run / "splat.ply"), build(DictConfig(splat))
    views = [*rendered.targets, *rendered.references]
    with torch.no_grad():
        drawn = {view.name: render(gaussians, camera_of(view), method) for view in views}
    depths: dict[str, Depths] = {
        "expected": {name: view.depth for name, view in drawn.items()},
        "surface": {name: view.surface for name, view in drawn.items()},
    }
    world = world_of(run)
    if world is not None:
        depths["exact"] = exact_depths(world, views)
    return depths


def exact_depths(world: tuple[str, int], views: Sequence[RenderedView]) -> Depths:
    """The exact z of the world in views; the sky lies far behind everything else."""
    return {view.name: with_sky(ProceduralView(*world, camera_of(view), "cpu").depth()) for view in views}


def world_of(run: Path) -> tuple[str, int] | None:
    """Family and seed of the procedural world that a run was fitted to; None for captures."""
    scene = read_configuration(run / "config.yaml").get("scene") or {}
    return (str(scene["family"]), int(scene["seed"])) if "family" in scene and "seed" in scene else None


def camera_of(view: RenderedView) -> Camera:
    """A view's camera, which must be known."""
    if view.camera is None:
        raise InputError(view.name, "has no camera to look from", "give a run with cameras")
    return view.camera


def with_sky(depth: Float[Tensor, "1 h w"]) -> Float[Tensor, "1 h w"]:
    """Fill holes in depth with the distance of the sky."""
    return torch.where(depth > 0, depth, FAR * depth.max().clamp_min(1.0))


def refuse_enlarging(enhancer: SetEnhancer) -> None:
    """Refuse networks whose images are finer than the renders that they are compared with."""
    if enhancer.network.scale != 1:
        raise InputError("weights", f"enlarge {enhancer.network.scale} times", "give weights of the render's own size")


def with_references(enhancer: SetEnhancer, config: ReferenceConfig) -> SetEnhancer:
    """The same enhancer with another reference configuration."""
    changed = copy.copy(enhancer)
    changed.reference_config = config
    return changed


def reference_configs(config: ReferenceConfig, depths: Mapping[str, Depths]) -> dict[str, ReferenceConfig]:
    """The reference configuration for each kind of known depth.

    Raises:
        InputError: it does not warp by depth.
    """
    warp = config.warp
    if not isinstance(warp, Reprojected):
        raise InputError("weights", "do not reproject their references", "give weights with alignment=reprojected")
    configs = {}
    for name, kind, search, smooth, consistent in SEARCHED:
        if kind in depths:
            searched = replace(warp, depth=search, smooth=smooth, consistent=consistent)
            configs[name] = replace(config, warp=ReplacedDepthWarp(depths[kind], searched))
    return configs


def propagate_residual(render: Float[Tensor, "3 h w"], aligned: AlignedReferences) -> Float[Tensor, "3 h w"]:
    """Add the references' residuals to the render, each weighted by the agreement of the splat's two renders.

    Raises:
        InputError: the splat's renders of the references are not known.
    """
    if aligned.renders is None:
        raise InputError("references", "come without the splat's renders of them", "give a run with training renders")
    visibility = aligned.visibility
    difference = (aligned.renders - render).abs().mean(1, keepdim=True)
    total, share = F.avg_pool2d(torch.cat([difference * visibility, visibility]), 5, 1, 2).chunk(2)
    weight = visibility * torch.exp(-total / share.clamp_min(1e-6) / SOFTNESS)
    residual = (weight * (aligned.references - aligned.renders)).sum(0) / (weight.sum(0) + PRIOR)
    return (render + residual).clamp(0, 1)


def reference_quality(
    aligned: AlignedReferences, render: Float[Tensor, "3 h w"], photo: Float[Tensor, "3 h w"]
) -> dict[str, float | None]:
    """PSNR of the first reference where it is visible, PSNR of the render on these pixels, and their share."""
    visible = aligned.visibility[:1] > 0.5  # empty without references
    if not bool(visible.any()):
        return {"reference_psnr": None, "render_psnr_there": None, "reference_visible": 0.0}
    mask = visible[0].float()
    return {
        "reference_psnr": psnr(aligned.references[0], photo, mask),
        "render_psnr_there": psnr(render, photo, mask),
        "reference_visible": float(mask.mean()),
    }


def measure_run(
    rendered: RenderedSet,
    enhancer: SetEnhancer,
    depths: Mapping[str, Depths],
    distances: Sequence[PerceptualDistance] = (),
    every: int = 1,
) -> Iterator[tuple[RenderedView, str, dict[str, float | None], dict[str, str]]]:
    """Metrics and reasons for missing ones by view and variant: "raw", then the rows of `SEARCHED`.

    Args:
        rendered: a run's held-out renders and training views.
        enhancer: the network; its reference configuration is used with every kind of depth.
        depths: by kind.
        distances: LPIPS distances to measure as well.
        every: take every n-th target.

    Raises:
        InputError: a target has no photo.
    """
    refuse_enlarging(enhancer)
    configs = reference_configs(enhancer.reference_config, depths)
    enhancers = {name: with_references(enhancer, config) for name, config in configs.items()}
    for view in enhanced_views(rendered, enhancers, distances, every):
        yield view.view, "raw", view.raw.metrics, view.raw.reasons
        for name, result in view.results.items():
            aligned, quality = result.aligned, result.measured
            shown = reference_quality(aligned, view.render, view.photo)
            reasons = {key: "no reference is visible" for key, value in shown.items() if value is None}
            simple: dict[str, float | None] = {"propagated_psnr": None}
            if aligned.renders is None:
                reasons["propagated_psnr"] = "the run kept no renders of its training views"
            else:
                simple["propagated_psnr"] = psnr(quantise_8_bit(propagate_residual(view.render, aligned)), view.photo)
            yield view.view, name, {**quality.metrics, **shown, **simple}, {**quality.reasons, **reasons}


def gains_over_raw(frame: pd.DataFrame) -> pd.DataFrame:
    """Every depth's rows with their gains over the raw render."""
    rows = with_gains(frame, {"variant": "raw"}, ("run", "view"))
    rows["gain of residuals"] = rows["propagated_psnr"] - (rows["psnr"] - rows["gain psnr"])
    return rows[rows["variant"] != "raw"]


def study(cfg: DictConfig, device: torch.device) -> Study[Path]:
    """Measure the same weights with every kind of depth.

    Raises:
        InputError: weights or runs cannot be used.
    """
    distances = requested_distances(cfg.lpips, cfg.backbones, device)
    pretrained = load_weights(cfg.weights)
    enhancer = SetEnhancer(pretrained.network, pretrained.reference_config, device, strength=cfg.strength)
    note = f"{PROTOCOL}; weights {Path(cfg.weights).name}, strength {cfg.strength:g}"

    def measure(fit: Path) -> Iterator[Record]:
        rendered = read_run(fit)
        splat = f"ours_{run_steps(fit)[-1]}"
        depths = depths_of(fit, replace(rendered, targets=rendered.targets[:: cfg.every]))
        for view, variant, metrics, reasons in measure_run(rendered, enhancer, depths, distances, cfg.every):
            size = (view.camera.width, view.camera.height) if view.camera is not None else (0, 0)
            record_key = (fit.name, scene_of(fit), splat, view.name, variant)
            yield Record("depth", *record_key, metrics, reasons, size, note)

    return Study(finished_fits(cfg.runs), measure, derived=gains_over_raw)


run = job(study)
