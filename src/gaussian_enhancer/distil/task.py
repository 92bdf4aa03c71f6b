"""Inputs of the job ``distil`` and of `distil_splat`: the splat, its capture, and the enhancer of new views."""

import copy
import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path

import torch
from omegaconf import DictConfig, open_dict

from gaussian_enhancer.align.references import ReferencePool
from gaussian_enhancer.checkpoint import find_checkpoint
from gaussian_enhancer.distil.distil import distil
from gaussian_enhancer.distil.prune import PruneResult, PruneSettings, prune
from gaussian_enhancer.distil.settings import DistilSettings
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import file_digest
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.validated_inputs import validate_inputs
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.runs.arguments import only_given, refuse_without_effect
from gaussian_enhancer.runs.enhancement import read_options, unlike_photos
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.rendered_capture import SplatRenderer, open_renderer, refuse_unseen
from gaussian_enhancer.runs.splat_source import splat_file
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.splat.io.result_folders import find_splat
from gaussian_enhancer.splat.io.small_files import check_format
from gaussian_enhancer.types import Gaussians

ENHANCEMENT_KEYS = ("weights", *(field.name for field in dataclasses.fields(EnhancementOptions)))
"""Configuration keys of enhancement; without effect where no view is enhanced."""


@dataclass(frozen=True)
class DistilTask:
    """The splat to improve, its capture, and the settings.

    Args:
        capture: photos, cameras and split.
        splat: file of the splat.
        renderer: renderer of the splat.
        settings: settings of distilling; None without distilling.
        prune: settings of pruning; None without pruning.
    """

    capture: Scene
    splat: Path
    renderer: SplatRenderer
    settings: DistilSettings | None
    prune: PruneSettings | None

    @property
    def makes_views(self) -> bool:
        """Whether enhanced views are made."""
        return self.settings is not None and self.settings.share > 0

    def mismatch_warnings(self) -> list[str]:
        """What `unlike_photos` warns of three training views."""
        return unlike_photos(ReferencePool([self.renderer.reference(photo) for photo in self.capture.train_photos]))


def read_distil_task(cfg: DictConfig, device: torch.device) -> DistilTask:
    """Read the splat and its capture by the job's configuration.

    Args:
        cfg: configuration of the job ``distil``.
        device: device on which the splat is rendered.

    Raises:
        InputError: see `distil_task`, or an option is out of range.
    """
    settings: DistilSettings = build(cfg.settings)
    prune_settings: PruneSettings = build(cfg.evidence)
    if cfg.run is not None and cfg.get("scene"):
        refuse_without_effect(["scene"], "run")
    capture = build(cfg.scene) if cfg.get("scene") else None
    splat, capture = find_splat_and_capture(cfg.run, cfg.gaussians, capture)
    return distil_task(
        splat,
        capture,
        None if cfg.prune_only else settings,
        prune_settings if cfg.prune or cfg.prune_only else None,
        method=cfg.method,
        device=device,
        invalid=cfg.invalid,
        file_format=cfg.format,
    )


def read_enhancer(cfg: DictConfig, task: DistilTask, device: torch.device) -> SetEnhancer | None:
    """Make the enhancer of new views by the job's configuration; None where no views are made.

    Args:
        cfg: configuration of the job ``distil``.
        task: splat, capture and settings.
        device: device of the network.

    Raises:
        InputError: see `enhancer_of_new_views`.
    """
    if not task.makes_views:
        return None
    options = read_options(cfg, plan="full")
    return enhancer_of_new_views(task, cfg.weights, options, device)


def find_splat_and_capture(
    run: str | Path | None, gaussians: str | Path | None, capture: Scene | None
) -> tuple[Path, Scene]:
    """Find a splat's file and its capture, by a run or by file and capture.

    Args:
        run: folder of a fitted run, this project's or original 3DGS output.
        gaussians: file of a splat, in place of ``run``; it needs a capture.
        capture: photos and cameras of ``gaussians``.

    Raises:
        InputError: neither or both of run and splat are given, the splat has no capture, the run is given with one, or
            the run cannot be read.
    """
    inputs = {"run": run, "gaussians": gaussians}
    only_given(inputs, "distil", "no splat", "give one of run=FOLDER, gaussians=FILE with scene=...")
    if gaussians is None:
        refuse_without_effect(["scene"] if capture is not None else [], "run")
        return _splat_and_capture_of_run(Path(run or ""))
    if capture is None:
        raise InputError("gaussians", "comes without its capture", "add scene=capture scene.path=FOLDER")
    return find_splat(gaussians), capture


def distil_task(
    splat: Path,
    capture: Scene,
    settings: DistilSettings | None,
    pruning: PruneSettings | None,
    *,
    method: str,
    device: torch.device,
    invalid: str = "refuse",
    file_format: str = "ply",
) -> DistilTask:
    """Read the splat and render it once, so that invalid input is refused before anything is written.

    Args:
        splat: file of the splat.
        capture: photos, cameras and split.
        settings: settings of distilling; None without distilling.
        pruning: settings of pruning; None without pruning.
        method: rendering method of the splat: "auto", "3dgs", "2dgs" or "mip_splatting".
        device: device on which it is rendered.
        invalid: treatment of Gaussians that are not finite: "refuse" or "drop".
        file_format: format of the result: "ply", "compressed" or "spz".

    Raises:
        InputError: the capture lacks photos or cameras, or the splat cannot be read, rendered or stored in the format,
            or lies outside the training views.
    """
    training_cameras = capture.train_cameras
    if len(training_cameras) < len(capture.train) or len(training_cameras) < 2:
        received = f"has {len(training_cameras)} training photos with a camera of {len(capture.train)}"
        raise InputError(capture.name, received, "give a capture of at least two photos, all with cameras")
    renderer = open_renderer(splat, training_cameras, capture.background, method, device.type, invalid)
    refuse_unseen(renderer, training_cameras, splat, capture.name)
    if file_format != "ply":
        check_format(file_format, renderer.gaussians)
    renderer(training_cameras[0].resized(8, 8))
    return DistilTask(capture, splat, renderer, settings, pruning)


def enhancer_of_new_views(
    task: DistilTask, weights: str | Path, options: EnhancementOptions, device: torch.device
) -> SetEnhancer:
    """Make the enhancer of renders of the task's splat, with its training photos as references.

    Args:
        task: splat, capture and settings.
        weights: a shipped name or a ``.safetensors`` file.
        options: options of enhancement.
        device: device of the network.

    Raises:
        InputError: the weights do not exist, enlarge images or use no photos, or an option is out of range.
    """
    pretrained = load_weights(weights)
    if pretrained.network.scale > 1 or pretrained.reference_config.references == 0:
        received = "enlarge what they enhance" if pretrained.network.scale > 1 else "use no photos"
        raise InputError(weights, received, "choose weights for the render's own size that use photos")
    if options.max_references == 0:
        raise InputError("max_references", "is 0", "give at least 1: views are weighed by what photos show")
    requested_config = options.reference_config(pretrained, "surface" if device.type == "cpu" else "expected")
    photos = task.capture.train_photos
    example = task.renderer.target("first", photos[0].camera)
    rendered = RenderedSet(task.capture.name, (example,), tuple(map(task.renderer.reference, photos)), own_depth=True)
    validated = validate_inputs(rendered, requested_config, options.rules)
    return options.enhancer(pretrained, validated.reference_config, device)


def improve_splat(
    task: DistilTask,
    enhancer: SetEnhancer | None,
    folder: Path,
    *,
    progress: bool,
    input_identity: str = "",
    on_pruned: Callable[[PruneResult], None] | None = None,
) -> Gaussians:
    """Prune and distil by the task; where the folder has a checkpoint of the same run, the run is resumed.

    Args:
        task: splat, capture and settings.
        enhancer: enhancer of new views; None where none are made.
        folder: folder of the checkpoint and the enhanced views.
        progress: whether to show progress bars.
        input_identity: see `distil`.
        on_pruned: called with the result of pruning, before distilling starts.

    Raises:
        InputError: see `distil`.
    """
    renderer = task.renderer
    if task.prune is not None:
        pruned = prune(renderer, task.capture.train_photos, task.prune)
        if on_pruned is not None:
            on_pruned(pruned)
        renderer = dataclasses.replace(renderer, gaussians=renderer.gaussians[pruned.kept])
    if task.settings is None:
        return renderer.gaussians
    return distil(
        task.capture, renderer, enhancer, folder, task.settings, progress=progress, input_identity=input_identity
    )


def naming_configuration(cfg: DictConfig, task: DistilTask) -> DictConfig:
    """Configuration that names the run's folder: without keys that have no effect, with hashes of file contents.

    Args:
        cfg: configuration of the job ``distil``.
        task: splat, capture and settings.
    """
    reduced_cfg = copy.deepcopy(cfg)
    digests = {"splat": file_digest(task.splat)}
    unused_keys: list[str] = [] if task.prune is not None else ["evidence"]
    if task.settings is None:
        unused_keys.append("settings")
    if not task.makes_views:
        unused_keys += ENHANCEMENT_KEYS
    else:
        digests["weights"] = file_digest(find_checkpoint(cfg.weights))
    with open_dict(reduced_cfg):
        for name in unused_keys:
            reduced_cfg.pop(name, None)
        reduced_cfg["made_of"] = digests
    return reduced_cfg


def _splat_and_capture_of_run(run: Path) -> tuple[Path, Scene]:
    """Splat of a run, and its photos with the run's split."""
    rendered = read_run(run)
    names = [view.name for view in (*rendered.targets, *rendered.references)]
    has_equal_names = len(set(names)) < len(names)  # 3DGS numbers test and training renders from 0 each
    held_out = _photos(rendered.targets, "test_" if has_equal_names else "")
    training = _photos(rendered.references, "train_" if has_equal_names else "")
    photos = sorted((*held_out, *training), key=attrgetter("name"))
    held_out_names = {photo.name for photo in held_out}
    train = tuple(index for index, photo in enumerate(photos) if photo.name not in held_out_names)
    test = tuple(index for index, photo in enumerate(photos) if photo.name in held_out_names)
    return splat_file(run), Scene(rendered.name, tuple(photos), train, test, rendered.background)


def _photos(views: Sequence[RenderedView], prefix: str) -> list[Photo]:
    """Photos of views; views without a photo are omitted, since they serve neither for training nor for measuring."""
    return [Photo(prefix + view.name, view.camera, view.read_photo) for view in views if view.read_photo is not None]
