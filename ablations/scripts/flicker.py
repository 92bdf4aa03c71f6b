"""``gaussian-enhancer flicker``: warped-frame error of raw and enhanced frames along a smooth path through a capture.

The run's splat is rendered along a smooth path through some neighbouring cameras of its capture; each frame is
enhanced with the run's training photos as references. The next frame is then warped onto each frame through rendered
depth, which is the same for all variants. In a procedural scene, exact photos along the path are measured too; they
have an error, since rendered depth is not exact and the warp blurs; the error grows with sharpness. By this measure
a blurred render flickers less than the truth. Therefore the study also measures the network's change alone: its
difference from frame to frame, as a share of its size. References are chosen anew for every frame, and pairs of frames
with changing references are compared with the others. Further variants are frames with temporal smoothing (`enhance
temporal_smoothing=S`), and frames whose candidate references are kept along the path until others cost less than the
share ``hysteresis`` of theirs.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import pandas as pd
import torch
from omegaconf import DictConfig
from torch import Tensor
from torchmetrics.functional.image import peak_signal_noise_ratio

from ablations.scripts.depth import refuse_enlarging, world_of
from ablations.studies.consistency import PROTOCOL, FrameGeometry, WarpedError, sequence_errors
from ablations.study.engine import Study, job
from ablations.study.fits import finished_fits, scene_of
from ablations.study.methods import load_enhancer
from ablations.study.rows import with_gains
from gaussian_enhancer.align.references import read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.path_references import PathReferences
from gaussian_enhancer.infer.temporal_smoothing import PreviousChange, smooth_change
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.runs.rendered_capture import render_capture
from gaussian_enhancer.scene.cameras import read_cameras
from gaussian_enhancer.scene.in_memory import read_once
from gaussian_enhancer.scene.path import short_tour, smooth_path
from gaussian_enhancer.scene.procedural.source import ProceduralView
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.types import Camera

STEADY = "steady "
"""Part of the names of variants with temporal smoothing; the share follows."""
PATH = "path "
"""Start of the names of variants whose references are chosen for the path; the factor follows."""
UNSEEN = "not measured: the frames show no common surface"


@dataclass(frozen=True)
class FrameSequence:
    """Frames along a path in every variant.

    Args:
        places: cameras and rendered geometry, one each frame.
        images: frames by variant.
        references: names of the references of each frame, best first, by variant whose frames chose them.
    """

    places: tuple[FrameGeometry, ...]
    images: dict[str, tuple[Tensor, ...]]
    references: dict[str, tuple[tuple[str, ...], ...]]


def path_cameras(run: Path, count: int, frames: int) -> tuple[Camera, ...]:
    """A smooth path through the middle ``count`` cameras of a run's capture, held-out ones among them."""
    listed = sorted(read_cameras(run / "cameras.json"), key=lambda listed_camera: listed_camera.name)
    tour = [listed[i].camera for i in short_tour([listed_camera.camera for listed_camera in listed])]
    if not 2 <= count <= len(tour):
        raise InputError("cameras", f"is {count}", f"give 2 to {len(tour)}, the cameras of {run.name}")
    start = (len(tour) - count) // 2
    return smooth_path(tour[start : start + count], frames)


def path_renders(run: Path, cameras: Sequence[Camera]) -> RenderedSet:
    """The run's splat as seen along a path, in memory, with its training views as references."""
    fitted = read_run(run)
    photos = tuple(Photo(f"path_{i:04d}.png", camera, _no_photo) for i, camera in enumerate(cameras))
    path = Scene(scene_of(run), photos, (), tuple(range(len(photos))), fitted.background)
    drawn = render_capture(str(run / "splat.ply"), path, "auto", "test")
    return RenderedSet(fitted.name, tuple(map(_in_memory, drawn.targets)), fitted.references, fitted.background)


def rendered_sequence(
    rendered: RenderedSet,
    enhancer: SetEnhancer,
    photos: Sequence[Tensor] = (),
    temporal_smoothing: Sequence[float] = (),
    hysteresis: Sequence[float] = (),
) -> FrameSequence:
    """Raw and enhanced frames of a path, by every choice of references and smoothing, and photos where they are known.

    Args:
        rendered: the path's frames, and the references.
        enhancer: chooses references for each frame by itself.
        photos: exact photos along the path; none where they are unknown.
        temporal_smoothing: shares of the change that are carried over.
        hysteresis: factors on the cost of the frame before's references, as `PathReferences` takes them.
    """
    refuse_enlarging(enhancer)
    single = enhancer.reference_config
    enhanced = list(enhancer(rendered))
    chosen = {"enhanced": enhanced}
    for factor in hysteresis:
        enhancer.reference_config = PathReferences.from_config(single, factor)
        chosen[f"{PATH}{factor:g}"] = list(enhancer(rendered))
    enhancer.reference_config = single
    places, raw = [], []
    for view in rendered.targets:
        if view.read is None or view.camera is None or view.read_depth is None:
            raise InputError(view.name, "lacks render, camera or depth", "render the path from a splat")
        places.append(FrameGeometry(view.camera, view.read_depth(), view.read_alpha() if view.read_alpha else None))
        raw.append(view.read())
    images = {"raw": tuple(raw), "enhanced": tuple(frame.image for frame in enhanced)}
    images["change"] = tuple(0.5 + frame.image - image for frame, image in zip(enhanced, raw, strict=True))
    for name, frames in chosen.items():
        shown = tuple(frame.image for frame in frames)
        images[name] = shown
        for share in temporal_smoothing:
            prefix = "" if name == "enhanced" else f"{name} "
            images[f"{prefix}{STEADY}{share:g}"] = tuple(_smooth_frames(rendered, shown, share))
    if photos:
        images["photo"] = tuple(photos)
    references = {name: tuple(frame.references for frame in frames) for name, frames in chosen.items()}
    return FrameSequence(tuple(places), images, references)


def _smooth_frames(rendered: RenderedSet, frames: Sequence[Tensor], share: float) -> Iterator[Tensor]:
    """Frames enhanced with ``temporal_smoothing=share``."""
    before: PreviousChange | None = None
    for view, enhanced in zip(rendered.targets, frames, strict=True):
        image, before = smooth_change(enhanced, read_target(view), before, share)
        yield image


def exact_photos(run: Path, cameras: Sequence[Camera]) -> tuple[Tensor, ...]:
    """Exact photos along the path, for runs of procedural scenes; empty for captures."""
    world = world_of(run)
    return () if world is None else tuple(ProceduralView(*world, camera, "cpu").photo() for camera in cameras)


def reference_changes(references: Sequence[Sequence[str]]) -> list[tuple[int, bool]]:
    """For each frame and the next, the number of new references, and whether only their order changes."""
    pairs = itertools.pairwise(map(tuple, references))
    return [(len(set(b) - set(a)), set(a) == set(b) and a != b) for a, b in pairs]


def sequence_records(run: Path, sequence: FrameSequence, weights: str) -> Iterator[Record]:
    """One record for each pair of neighbouring frames and variant."""
    changed = {name: reference_changes(chosen) for name, chosen in sequence.references.items()}
    for variant, images in sequence.images.items():
        for t, error in enumerate(sequence_errors(images, sequence.places)):
            size = (images[t].shape[2], images[t].shape[1])
            record_key = (run.name, scene_of(run), f"ours_{run_steps(run)[-1]}", f"path_{t:04d}.png", variant)
            metrics = _metrics(error)
            reasons = {name: UNSEEN for name, value in metrics.items() if value is None}
            if variant in changed:
                added, reordered = changed[variant][t]
                metrics |= {"references_new": float(added), "references_reordered": float(reordered)}
            elif variant == "change":
                metrics["size"] = float((images[t] - 0.5).abs().mean())
            if "photo" in sequence.images and variant not in ("photo", "change"):
                metrics["psnr"] = float(peak_signal_noise_ratio(images[t], sequence.images["photo"][t], data_range=1.0))
            note = PROTOCOL if variant in ("raw", "photo") else f"{PROTOCOL}; weights {weights}"
            yield Record("consistency", *record_key, metrics, reasons, size, note)


def compare_variants(frame: pd.DataFrame) -> pd.DataFrame:
    """The pairs of frames that show a common surface, with their error relative to raw frames and to exact photos.

    An error "over" another is divided by the other's mean over the pairs that both have, so that its mean over pairs is
    the ratio of the two means.
    """
    rows = with_gains(frame, {"variant": "raw"}, ("run", "view"))
    rows = with_other(with_other(rows[rows["visible"] > 0], "raw"), "photo")
    error, groups = rows["warped_error"], [rows["run"], rows["variant"]]
    for name in ("raw", "photo", "size"):
        baseline = rows[name].where(error.notna())
        rows[f"error over {name}"] = error.where(baseline.notna()) / baseline.groupby(groups).transform("mean")
    added, excess = rows["references_new"], 255 * (error - rows["raw"])
    gain = rows["gain psnr"] if "gain psnr" in rows else math.nan * error
    columns = {
        "error": 255 * error,
        "excess at new references": excess.where(added > 0),
        "excess elsewhere": excess.where(added == 0),
        "gain psnr": gain.where(rows["variant"] != "raw"),
    }
    return rows.assign(**columns)


def with_other(frame: pd.DataFrame, variant: str) -> pd.DataFrame:
    """The frame with a column that holds the error of another variant of the same pair of frames."""
    other_errors = frame.loc[frame["variant"] == variant, ["run", "view", "warped_error"]]
    return frame.merge(other_errors.rename(columns={"warped_error": variant}), on=["run", "view"], how="left")


def _metrics(error: WarpedError) -> dict[str, float | None]:
    values = (error.mean, error.rms, error.decibel) if error.visible else (None, None, None)
    names = ("warped_error", "warped_rms", "warped_psnr")
    return {**dict(zip(names, values, strict=True)), "visible": error.visible}


def _no_photo() -> Tensor:
    raise InputError("path", "has no photo", "request renders only")


def _in_memory(view: RenderedView) -> RenderedView:
    """The view with its pixels in memory, since each is read more than once."""
    view = read_once(dataclasses.replace(view, read_photo=None))
    for read in (view.read, view.read_depth, view.read_alpha):
        if read is not None:
            read()
    return view


def study(cfg: DictConfig, device: torch.device) -> Study[Path]:
    """Every kind of frames along each run's path.

    Raises:
        InputError: weights or runs cannot be used.
    """
    options = EnhancementOptions(strength=cfg.strength)
    load = cache(partial(load_enhancer, cfg.weights, options, device))  # only if something has to be measured

    def measure(fit: Path) -> Iterator[Record]:
        digest, enhancer = load()
        weights = f"{Path(cfg.weights).name} {digest}, strength {enhancer.strength:g}"
        cameras = path_cameras(fit, cfg.cameras, cfg.frames)
        photos = exact_photos(fit, cameras)
        drawn = path_renders(fit, cameras)
        return sequence_records(
            fit, rendered_sequence(drawn, enhancer, photos, cfg.temporal_smoothing, cfg.hysteresis), weights
        )

    return Study(finished_fits(cfg.runs), measure, derived=compare_variants)


run = job(study)
