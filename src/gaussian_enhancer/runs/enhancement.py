"""From the configuration of the job ``enhance`` to what enhances, what is enhanced, and what of it is used."""

import copy
from dataclasses import replace

import torch
from omegaconf import DictConfig, open_dict

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.validated_inputs import ValidatedInputs, validate_inputs
from gaussian_enhancer.infer.weights import Pretrained, load_weights
from gaussian_enhancer.runs.inputs import Task, read_task
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.runtime import choose_device


def options_of(cfg: DictConfig) -> EnhancementOptions:
    """The options that a configuration states.

    Raises:
        InputError: one is unknown or out of range.
    """
    return EnhancementOptions(
        cfg.max_references,
        cfg.depth_kind,
        cfg.strength,
        cfg.colour_clamping,
        cfg.temporal_smoothing,
        cfg.precision,
        cfg.tile,
        build(cfg.plan),
        cfg.colour_completion,
        cfg.confidence,
    )


def ready(cfg: DictConfig, device: torch.device) -> tuple[SetEnhancer, Task, ValidatedInputs]:
    """Load the weights, read the input and validate it.

    Args:
        cfg: configuration of the job ``enhance``.
        device: where the network runs.

    Returns:
        What enhances, what is enhanced, and what of the input is used.

    Raises:
        InputError: there are no such weights, the input cannot be read, or an option is out of range.
    """
    pretrained = load_weights(cfg.weights)
    task = read_task(cfg, device.type, pretrained.reference_config.fine)
    return prepared(pretrained, task, options_of(cfg), device)


def prepared(
    pretrained: Pretrained, task: Task, options: EnhancementOptions, device: torch.device
) -> tuple[SetEnhancer, Task, ValidatedInputs]:
    """Validate the input of a task and build its enhancer.

    Args:
        pretrained: the weights.
        task: what was given.
        options: how it is enhanced.
        device: where the network runs.

    Raises:
        InputError: there are no references where some are asked for, or an option is out of range.
    """
    asked = options.reference_config(pretrained, task.depth)
    found = validate_inputs(task.rendered, asked, options.rules, pretrained.network.scale)
    enhancer = options.enhancer(pretrained, found.reference_config, device)
    return enhancer, replace(task, rendered=found.rendered), found


def with_effect(cfg: DictConfig) -> DictConfig:
    """The configuration without keys that change no image, from which the run's folder gets its name.

    A plan that leaves nothing out is such a key, and so are a time budget and temporal smoothing that are not set.

    Args:
        cfg: configuration of the job ``enhance``.
    """
    kept = copy.deepcopy(cfg)
    with open_dict(kept):
        unset = {name: not kept.get(name) for name in ("budget_ms", "temporal_smoothing")}
        for name, idle in {"dry_run": True, **unset, "plan": build(cfg.plan).full}.items():
            if idle:
                kept.pop(name, None)
    return kept


def process_count(cfg: DictConfig) -> int:
    """How many processes share the views.

    Args:
        cfg: configuration of the job ``enhance``.

    Raises:
        InputError: the number is not positive, there are fewer graphics cards, or each frame depends on the one before.
    """
    count = cfg.runtime.get("processes", 1)
    if not isinstance(count, int) or count < 1:
        raise InputError("runtime.processes", f"is {count!r}", "give a positive number")
    if count > 1 and cfg.temporal_smoothing:
        received = f"is {count} with temporal_smoothing={cfg.temporal_smoothing}"
        raise InputError("runtime.processes", received, "enhance a path by one process")
    if count > 1 and choose_device(cfg.runtime.device).type == "cuda" and count > torch.cuda.device_count():
        received = f"is {count} on {torch.cuda.device_count()} graphics cards"
        raise InputError("runtime.processes", received, "give at most one process a card")
    return count
