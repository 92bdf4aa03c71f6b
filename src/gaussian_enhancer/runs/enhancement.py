"""Builds the enhancer, the task and the validated inputs from the configuration of the job ``enhance``."""

import copy
import statistics
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, open_dict

from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.align.references import ReferencePool
from gaussian_enhancer.checkpoint import checkpoint_digest, find_checkpoint
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.earlier_step import TwoStepEnhancer
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.validated_inputs import ValidatedInputs, validate_inputs
from gaussian_enhancer.infer.weights import Pretrained, load_weights
from gaussian_enhancer.metrics.image_quality import psnr
from gaussian_enhancer.runs.inputs import Task, read_task, refuse_input_folder
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.recovered_geometry import lacks_geometry, recover_geometry, recovery_progress
from gaussian_enhancer.runs.runtime import choose_device
from gaussian_enhancer.scene.neighbours import choose_references
from gaussian_enhancer.scene.photos import resize
from gaussian_enhancer.scene.splits import evenly_spaced

MATCHING_PSNR = 12.0
"""Least PSNR in dB between photos and a splat's renders of the same views. Between seven fits and the captures of each
other, the median of three views is below 12 dB in 40 of 42 pairs (informal measurement); their own give 18 to 30 dB."""


def read_options(cfg: DictConfig, **given: Any) -> EnhancementOptions:
    """Read the enhancement options of a configuration.

    Args:
        cfg: configuration of a job that enhances. Options that it lacks keep their defaults.
        given: values of options that replace the configuration's.

    Raises:
        InputError: an option is unknown or out of range.
    """
    values = {field.name: cfg[field.name] for field in fields(EnhancementOptions) if field.name in cfg}
    if "plan" in cfg and "plan" not in given:
        values["plan"] = build(cfg.plan)
    return EnhancementOptions(**{**values, **given})


def load_options(cfg: DictConfig, device: torch.device) -> tuple[Pretrained, EnhancementOptions]:
    """Load the weights and read the options, and refuse those out of range before anything is computed.

    Args:
        cfg: configuration of the job ``enhance``.
        device: device of the network.

    Raises:
        InputError: the weights do not exist, or an option is out of range.
    """
    pretrained, options = load_weights(cfg.weights), read_options(cfg)
    options.enhancer(pretrained, options.reference_config(pretrained, "expected"), device)
    return pretrained, options


def load_enhancement(cfg: DictConfig, device: torch.device) -> tuple[SetEnhancer, Task, ValidatedInputs]:
    """Load the weights, read the input and validate it.

    Args:
        cfg: configuration of the job ``enhance``.
        device: device of the network.

    Returns:
        The enhancer, the task, and the validated inputs.

    Raises:
        InputError: the weights do not exist, the input cannot be read, the output folder holds files of it, or an
            option is out of range.
    """
    pretrained, options = load_options(cfg, device)
    task = read_task(cfg, device.type, pretrained.reference_config.fine)
    if cfg.output:
        refuse_input_folder(Path(cfg.output), task.rendered)
    if cfg.get("recover_geometry"):  # an option of the job enhance alone
        folder = Path(cfg.output or cfg.runs) / "geometry"
        task = recover_missing_geometry(task, pretrained, options, folder, cfg.runtime.progress)
    return prepare_enhancement(pretrained, task, options, device)


def recover_missing_geometry(
    task: Task, pretrained: Pretrained, options: EnhancementOptions, folder: Path, show_progress: bool = False
) -> Task:
    """Recover cameras and depth from the task's images if references are to be warped and their geometry is missing.

    Args:
        task: the input of the user.
        pretrained: the weights.
        options: options of the enhancement.
        folder: folder in which the recovered geometry is kept (`recover_geometry`).
        show_progress: show a progress bar.

    Raises:
        InputError: an image cannot be read, or the folder cannot be written.
    """
    config = options.reference_config(pretrained, task.depth)
    warped = config.references > 0 and isinstance(config.warp, Reprojected) and options.rules.depth != "none"
    if not warped or not lacks_geometry(task.rendered):
        return task
    with recovery_progress(show_progress) as progress:
        recovered = recover_geometry(task.rendered, folder, progress)
    origins = {"cameras": recovered.cameras, "depth": recovered.depth}
    origins = {name: origin for name, origin in origins.items() if origin}
    return replace(task, rendered=recovered.rendered, depth="expected", origins=origins)


def prepare_enhancement(
    pretrained: Pretrained, task: Task, options: EnhancementOptions, device: torch.device
) -> tuple[SetEnhancer, Task, ValidatedInputs]:
    """Validate the input of a task and build its enhancer.

    Args:
        pretrained: the weights.
        task: the input of the user.
        options: options of the enhancement.
        device: device of the network.

    Raises:
        InputError: references are requested but there are none, or an option is out of range.
    """
    config = options.reference_config(pretrained, task.depth)
    validated = validate_inputs(task.rendered, config, options.rules, pretrained.network.scale, origins=task.origins)
    enhancer = options.enhancer(pretrained, validated.reference_config, device)
    if task.earlier:
        enhancer = TwoStepEnhancer(enhancer, task.earlier)
    return enhancer, replace(task, rendered=validated.rendered), validated


def lost_references(enhancer: SetEnhancer, task: Task, validated: ValidatedInputs) -> list[str]:
    """List the renders that are written unchanged because no photo can be used for them, with the reason.

    Args:
        enhancer: the enhancer.
        task: the task.
        validated: the validated inputs.
    """
    if not enhancer.pass_through or enhancer.network.scale > 1:
        return []
    if validated.missing_references and enhancer.reference_config.references == 0:
        failure = "" if any(view.camera for view in task.rendered.targets) else task.origins.get("cameras", "")
        return [
            f"no photo can be used ({failure or validated.missing_references[0]}). Every render is written unchanged."
        ]
    if validated.unreached:
        count = f"{len(validated.unreached)} of {len(task.rendered.targets)} renders have no camera or no depth"
        return [f"{count}, so that no photo can be used: {', '.join(validated.unreached)}. They are written unchanged."]
    return []


def mismatch_warnings(validated: ValidatedInputs) -> list[str]:
    """What `unlike_photos` warns of the three references nearest to the first target.

    The pool keeps them for the enhancement.

    Args:
        validated: the validated inputs.
    """
    config, pool = validated.reference_config, validated.pool
    nearest = choose_references(validated.rendered.targets[0], pool.views, 3) if config.references else ()
    return unlike_photos(pool, nearest, config.fine)


def unlike_photos(pool: ReferencePool, indices: Sequence[int] | None = None, fine: bool = False) -> list[str]:
    """A warning if the splat's renders of references are unlike their photos (`MATCHING_PSNR`), else nothing.

    Args:
        pool: photos with the splat's renders of their views; those without a render are not compared.
        indices: of the references that are compared; None takes three, evenly spaced.
        fine: read them so that the pool keeps their finer photos readable as well.
    """
    chosen = evenly_spaced(range(len(pool.views)), 3) if indices is None else indices
    views = [pool.read(index, fine) for index in chosen]
    pairs = [(view.image, view.render) for view in views if view.render is not None]
    values = [psnr(resize(photo, *render.shape[-2:]), render) for photo, render in pairs]
    median = statistics.median(values) if values else MATCHING_PSNR
    if median >= MATCHING_PSNR:
        return []
    found = f"the splat's renders are unlike their photos (median PSNR {median:.1f} dB)"
    return [f"{found}. It may be of another capture, in other coordinates, or over another background."]


def naming_configuration(cfg: DictConfig) -> DictConfig:
    """Configuration that names the run's folder: without keys that change no image.

    Removed are a plan that leaves nothing out, an unset time budget, an unset temporal smoothing, an unset
    distillation, an unset second splat, no earlier step, and the recovery of geometry where the input is a run or a
    splat, which have their own. The digest of the weights is added, so that a file with new content leads to a new run.

    Args:
        cfg: configuration of the job ``enhance`` or ``video``.

    Raises:
        InputError: the weights do not exist.
    """
    configuration = copy.deepcopy(cfg)
    with open_dict(configuration):
        configuration.weights_digest = checkpoint_digest(find_checkpoint(cfg.weights))
        idle_keys = ["dry_run"]
        options = "budget_ms", "temporal_smoothing", "distil", "second", "earlier_step"
        idle_keys += [name for name in options if not cfg.get(name)]
        if build(cfg.plan).full:
            idle_keys.append("plan")
        if cfg.get("recover_geometry") and cfg.get("renders") is None:
            idle_keys.append("recover_geometry")
        for name in idle_keys:
            configuration.pop(name, None)
    return configuration


def process_count(cfg: DictConfig) -> int:
    """The number of processes that share the views.

    Args:
        cfg: configuration of the job ``enhance``.

    Raises:
        InputError: there are fewer graphics cards, or each frame depends on the previous one (temporal smoothing).
    """
    count: int = cfg.runtime.get("processes", 1)
    if count > 1 and cfg.temporal_smoothing:
        received = f"is {count} with temporal_smoothing={cfg.temporal_smoothing}"
        raise InputError("runtime.processes", received, "enhance a path by one process")
    if count > 1 and choose_device(cfg.runtime.device).type == "cuda" and count > torch.cuda.device_count():
        received = f"is {count} on {torch.cuda.device_count()} graphics cards"
        raise InputError("runtime.processes", received, "give at most one process a card")
    return count
