"""From the configuration of the job ``distil`` to the splat, its capture, and what enhances its views."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from omegaconf import DictConfig, open_dict

from gaussian_enhancer.checkpoint import find_checkpoint
from gaussian_enhancer.distil.prune import PruneSettings
from gaussian_enhancer.distil.settings import DistilSettings
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.validated_inputs import validate_inputs
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.rendered_capture import SplatRenderer, open_renderer
from gaussian_enhancer.runs.splat_source import given_file, splat_file
from gaussian_enhancer.runs.video import file_digest
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.splat.io.small_files import check_format

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


def read_distil_task(cfg: DictConfig, device: torch.device) -> DistilTask:
    """Read the splat and its capture.

    Args:
        cfg: configuration of the job ``distil``.
        device: where the splat is rendered.

    Raises:
        InputError: no splat or several were given, the input cannot be read, or an option is out of range.
    """
    given = [name for name in ("run", "gaussians") if cfg[name] is not None]
    if len(given) != 1:
        received = f"was given {' and '.join(given)}" if given else "was given no splat"
        raise InputError("distil", received, "give one of run=FOLDER, gaussians=FILE with scene=...")
    settings: DistilSettings = build(cfg.settings)
    evidence: PruneSettings = build(cfg.evidence)
    splat, capture = _of_run(Path(cfg.run)) if cfg.run is not None else _of_splat(cfg)
    training = [photo.camera for photo in capture.train_photos if photo.camera is not None]
    if len(training) < len(capture.train) or len(training) < 2:
        received = f"has {len(training)} training photos with a camera of {len(capture.train)}"
        raise InputError(capture.name, received, "give a capture of at least two photos, all with cameras")
    renderer = open_renderer(splat, training, capture.background, cfg.method, device.type, cfg.invalid)
    if cfg.format != "ply":
        check_format(cfg.format, renderer.gaussians)
    renderer(training[0].resized(8, 8))  # refuses what cannot be rendered before anything is written
    further = None if cfg.prune_only else settings
    return DistilTask(capture, splat, renderer, further, evidence if cfg.prune or cfg.prune_only else None)


def read_enhancer(cfg: DictConfig, task: DistilTask, device: torch.device) -> SetEnhancer | None:
    """What enhances new views; None where there are none.

    Args:
        cfg: configuration of the job ``distil``.
        task: what is distilled.
        device: where the network runs.

    Raises:
        InputError: there are no such weights, they enlarge or use no photos, or an option is out of range.
    """
    if task.settings is None or task.settings.share == 0:
        return None
    pretrained = load_weights(cfg.weights)
    if pretrained.network.scale > 1 or pretrained.reference_config.references == 0:
        received = "enlarge what they enhance" if pretrained.network.scale > 1 else "use no photos"
        raise InputError(cfg.weights, received, "choose weights for the render's own size that use photos")
    kept = (cfg.max_references, cfg.depth_kind, cfg.strength, cfg.colour_clamping)
    options = EnhancementOptions(*kept, 0.0, cfg.precision, cfg.tile, "full", cfg.colour_completion, cfg.confidence)
    if options.max_references == 0:
        raise InputError("max_references", "is 0", "give at least 1: views are weighed by what photos show")
    asked = options.reference_config(pretrained, "surface" if device.type == "cpu" else "expected")
    photos = task.capture.train_photos
    one = task.renderer.target("first", photos[0].camera)
    rendered = RenderedSet(task.capture.name, (one,), tuple(map(task.renderer.reference, photos)), own_depth=True)
    found = validate_inputs(rendered, asked, options.rules)
    return options.enhancer(pretrained, found.reference_config, device)


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
    if task.settings is None or task.settings.share == 0:
        idle += ENHANCING
    else:
        made_of["weights"] = file_digest(find_checkpoint(cfg.weights))
    with open_dict(kept):
        for name in idle:
            kept.pop(name, None)
        kept["made_of"] = made_of
    return kept


def _of_run(run: Path) -> tuple[Path, Scene]:
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


def _of_splat(cfg: DictConfig) -> tuple[Path, Scene]:
    if not cfg.get("scene"):
        raise InputError("gaussians", "comes without its capture", "add scene=capture scene.path=FOLDER")
    return given_file(cfg.gaussians), build(cfg.scene)
