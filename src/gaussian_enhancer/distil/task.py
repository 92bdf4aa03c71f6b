"""From what the job ``distil`` or `distil_splat` is given to the splat, its capture, and what enhances its views."""

import copy
import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from omegaconf import DictConfig, open_dict

from gaussian_enhancer.checkpoint import find_checkpoint
from gaussian_enhancer.distil.distil import distil
from gaussian_enhancer.distil.prune import Pruned, PruneSettings, prune
from gaussian_enhancer.distil.settings import DistilSettings
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.validated_inputs import validate_inputs
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.rendered_capture import SplatRenderer, open_renderer
from gaussian_enhancer.runs.splat_source import find_splat_file, splat_file
from gaussian_enhancer.runs.video import file_digest
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.splat.io.small_files import check_format
from gaussian_enhancer.types import Gaussians

ENHANCING = (
    "weights",
    "max_references",
    "depth_kind",
    "strength",
    "colour_clamping",
    "colour_completion",
    "confidence",
    "precision",
    "tile",
)
"""Keys that say how views are enhanced; without effect where none is."""


@dataclass(frozen=True)
class DistilTask:
    """What is distilled into what.

    Args:
        capture: photos, their cameras and their split.
        splat: the splat's file.
        renderer: the splat and how it is rendered.
        settings: of the further steps; None where there are none.
        prune: what counts as evidence of empty space; None where nothing is removed.
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


def read_distil_task(cfg: DictConfig, device: torch.device) -> DistilTask:
    """Read the splat and its capture, as the job's configuration names them.

    Args:
        cfg: configuration of the job ``distil``.
        device: where the splat is rendered.

    Raises:
        InputError: as `distil_task`, or an option is out of range.
    """
    settings: DistilSettings = build(cfg.settings)
    evidence: PruneSettings = build(cfg.evidence)
    capture = build(cfg.scene) if cfg.run is None and cfg.get("scene") else None
    splat, capture = read_given_splat(cfg.run, cfg.gaussians, capture)
    further = None if cfg.prune_only else settings
    pruning = evidence if cfg.prune or cfg.prune_only else None
    return distil_task(
        splat, capture, further, pruning, method=cfg.method, device=device, invalid=cfg.invalid, kind=cfg.format
    )


def read_enhancer(cfg: DictConfig, task: DistilTask, device: torch.device) -> SetEnhancer | None:
    """What enhances new views, as the job's configuration says; None where there are none.

    Args:
        cfg: configuration of the job ``distil``.
        task: what is distilled.
        device: where the network runs.

    Raises:
        InputError: as `enhancer_of_new_views`.
    """
    if not task.makes_views:
        return None
    kept = (cfg.max_references, cfg.depth_kind, cfg.strength, cfg.colour_clamping)
    options = EnhancementOptions(*kept, 0.0, cfg.precision, cfg.tile, "full", cfg.colour_completion, cfg.confidence)
    return enhancer_of_new_views(task, cfg.weights, options, device)


def read_given_splat(run: str | Path | None, gaussians: str | Path | None, capture: Scene | None) -> tuple[Path, Scene]:
    """A splat's file and its capture: of a run, or as they were given.

    Args:
        run: folder of a fitted run, ours or original 3DGS output.
        gaussians: instead: file of a splat, which needs a capture.
        capture: photos and cameras of ``gaussians``.

    Raises:
        InputError: no splat or several were given, a splat without its capture, or the run cannot be read.
    """
    if run is not None and gaussians is None:
        return _capture_of_run(Path(run))
    if gaussians is None or run is not None:
        received = "was given no splat" if gaussians is None else "was given run and gaussians"
        raise InputError("distil", received, "give one of run=FOLDER, gaussians=FILE with scene=...")
    if capture is None:
        raise InputError("gaussians", "comes without its capture", "add scene=capture scene.path=FOLDER")
    return find_splat_file(gaussians), capture


def distil_task(
    splat: Path,
    capture: Scene,
    settings: DistilSettings | None,
    pruning: PruneSettings | None,
    *,
    method: str,
    device: torch.device,
    invalid: str = "refuse",
    kind: str = "ply",
) -> DistilTask:
    """Read the splat and try to render it, so that nothing is written for input that cannot be used.

    Args:
        splat: the splat's file.
        capture: photos, their cameras and their split.
        settings: of the further steps; None where there are none.
        pruning: what counts as evidence of empty space; None where nothing is removed.
        method: how the splat is rendered: "auto", "3dgs", "2dgs" or "mip_splatting".
        device: where it is rendered.
        invalid: what to do with Gaussians that are not finite: "refuse" or "drop".
        kind: format of the result: "ply", "compressed" or "spz".

    Raises:
        InputError: the capture lacks photos or cameras, or the splat cannot be read, rendered or stored so.
    """
    training = [photo.camera for photo in capture.train_photos if photo.camera is not None]
    if len(training) < len(capture.train) or len(training) < 2:
        received = f"has {len(training)} training photos with a camera of {len(capture.train)}"
        raise InputError(capture.name, received, "give a capture of at least two photos, all with cameras")
    renderer = open_renderer(splat, training, capture.background, method, device.type, invalid)
    if kind != "ply":
        check_format(kind, renderer.gaussians)
    renderer(training[0].resized(8, 8))
    return DistilTask(capture, splat, renderer, settings, pruning)


def enhancer_of_new_views(
    task: DistilTask, weights: str | Path, options: EnhancementOptions, device: torch.device
) -> SetEnhancer:
    """What enhances renders of the task's splat with its training photos.

    Args:
        task: what is distilled.
        weights: a shipped name or a ``.safetensors`` file.
        options: of the enhancement.
        device: where the network runs.

    Raises:
        InputError: there are no such weights, they enlarge or use no photos, or an option is out of range.
    """
    pretrained = load_weights(weights)
    if pretrained.network.scale > 1 or pretrained.reference_config.references == 0:
        received = "enlarge what they enhance" if pretrained.network.scale > 1 else "use no photos"
        raise InputError(weights, received, "choose weights for the render's own size that use photos")
    if options.max_references == 0:
        raise InputError("max_references", "is 0", "give at least 1: views are weighed by what photos show")
    asked = options.reference_config(pretrained, "surface" if device.type == "cpu" else "expected")
    photos = task.capture.train_photos
    one = task.renderer.target("first", photos[0].camera)
    rendered = RenderedSet(task.capture.name, (one,), tuple(map(task.renderer.reference, photos)), own_depth=True)
    found = validate_inputs(rendered, asked, options.rules)
    return options.enhancer(pretrained, found.reference_config, device)


def improve_splat(
    task: DistilTask,
    enhancer: SetEnhancer | None,
    folder: Path,
    *,
    progress: bool,
    made_of: str = "",
    on_pruned: Callable[[Pruned], None] | None = None,
) -> Gaussians:
    """Prune and distil, each where the task says so; a folder with a checkpoint of the same work is continued.

    Args:
        task: what is distilled.
        enhancer: of new views; None where there are none.
        folder: holds the checkpoint and the enhanced views.
        progress: show progress bars.
        made_of: as in `distil`.
        on_pruned: is told what was removed, before the steps begin.

    Raises:
        InputError: as `distil`.
    """
    renderer = task.renderer
    if task.prune is not None:
        found = prune(renderer, task.capture.train_photos, task.prune)
        if on_pruned is not None:
            on_pruned(found)
        renderer = dataclasses.replace(renderer, gaussians=renderer.gaussians[found.kept])
    if task.settings is None:
        return renderer.gaussians
    return distil(task.capture, renderer, enhancer, folder, task.settings, progress=progress, made_of=made_of)


def run_configuration(cfg: DictConfig, task: DistilTask) -> DictConfig:
    """The configuration from which the run's folder gets its name: without what has no effect, files by their content.

    Args:
        cfg: configuration of the job ``distil``.
        task: what is distilled.
    """
    kept = copy.deepcopy(cfg)
    made_of = {"splat": file_digest(task.splat)}
    idle: list[str] = [] if task.prune is not None else ["evidence"]
    if task.settings is None:
        idle.append("settings")
    if not task.makes_views:
        idle += ENHANCING
    else:
        made_of["weights"] = file_digest(find_checkpoint(cfg.weights))
    with open_dict(kept):
        for name in idle:
            kept.pop(name, None)
        kept["made_of"] = made_of
    return kept


def _capture_of_run(run: Path) -> tuple[Path, Scene]:
    """A run's splat, and its photos under its own split."""
    rendered = read_run(run)
    names = [view.name for view in (*rendered.targets, *rendered.references)]
    alike = len(set(names)) < len(names)  # 3DGS numbers the renders of each side from 0
    held_out = _photos(rendered.targets, "test_" if alike else "")
    photos = sorted((*held_out, *_photos(rendered.references, "train_" if alike else "")), key=lambda one: one.name)
    apart = {photo.name for photo in held_out}
    train = tuple(index for index, photo in enumerate(photos) if photo.name not in apart)
    test = tuple(index for index, photo in enumerate(photos) if photo.name in apart)
    return splat_file(run), Scene(rendered.name, tuple(photos), train, test, rendered.background)


def _photos(views: Sequence[RenderedView], prefix: str) -> list[Photo]:
    """The photos of a side; views without one can neither be learnt from nor measured."""
    return [Photo(prefix + view.name, view.camera, view.read_photo) for view in views if view.read_photo is not None]
