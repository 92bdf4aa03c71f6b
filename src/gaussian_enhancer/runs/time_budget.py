"""``budget_ms=`` of enhance and video: choose the best preset that keeps within a time here, at this image size.

``gaussian-enhancer tradeoff`` measured the presets on validation scenes, usually on another machine. The fastest preset
is timed on the first view here, and the recorded times are scaled by the ratio.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from hydra import compose
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf, open_dict
from rich.console import Console

from gaussian_enhancer.checkpoint import SHIPPED_FOLDER
from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.presets import Preset, choose_preset, read_presets
from gaussian_enhancer.metrics.cost import time_interleaved
from gaussian_enhancer.scene.in_memory import single_target_sets
from gaussian_enhancer.scene.rendered import RenderedSet

PRESETS = SHIPPED_FOLDER / "settings.json"

BUDGET_KEYS = ("weights", "max_references", "precision", "tile", "ensemble")
"""Options that a budget sets, and that therefore cannot be given together with it."""


def apply_budget(
    cfg: DictConfig, prepare: Callable[[DictConfig, torch.device], Any], device: torch.device, console: Console
) -> DictConfig:
    """Replace ``budget_ms`` in a configuration by the best preset that keeps within it.

    The result equals the configuration of a user who asks for that preset's values. A configuration without a budget
    is returned as it is.

    Args:
        cfg: configuration of the job ``enhance`` or ``video``.
        prepare: returns a `SetEnhancer`, the job's input and further values for a configuration and a device.
        device: where the network runs.
        console: where the choice and its reason are printed.

    Raises:
        InputError: no preset keeps within the budget, none was measured, or one of `BUDGET_KEYS` was given as well.
    """
    if cfg.get("budget_ms") is None:
        return cfg
    _refuse_overridden(cfg)
    presets = read_presets(PRESETS)
    enhancer, task, *_ = prepare(_apply_preset(cfg, presets[0]), device)
    milliseconds, megapixels = time_first_view(enhancer, task.rendered)
    speed = milliseconds / (presets[0].milliseconds * megapixels)
    chosen, line = choose_preset(presets, float(cfg.budget_ms), megapixels, speed)
    print_line(console, line)
    return _apply_preset(cfg, chosen)


def time_first_view(enhancer: SetEnhancer, rendered: RenderedSet) -> tuple[float, float]:
    """Time the first view: the median of three runs after a warm-up.

    Args:
        enhancer: enhancer with the fastest preset.
        rendered: the set that the job enhances.

    Returns:
        Milliseconds, and the megapixels of the enhanced image.

    Raises:
        InputError: there is no view, or it cannot be read.
    """
    if not rendered.targets:
        raise InputError(rendered.name, "has no render to enhance", "render held-out views first")
    (first_view,) = single_target_sets(replace(rendered, targets=rendered.targets[:1]), 1)
    height, width = next(enhancer(first_view)).image.shape[-2:]
    calls = {"": lambda: next(enhancer(first_view))}
    timing = time_interleaved(calls, repeats=3, warm_up=0, device=enhancer.device)[""]
    return timing.milliseconds, height * width / 1e6


def _apply_preset(cfg: DictConfig, preset: Preset) -> DictConfig:
    """The configuration with the values of a preset in place of the budget."""
    chosen = OmegaConf.merge(cfg, OmegaConf.from_dotlist(list(preset.enhance)))
    if not isinstance(chosen, DictConfig):
        raise TypeError("a job's configuration is a mapping")
    with open_dict(chosen):
        chosen.update({"weights": preset.weights, "budget_ms": None})
    return chosen


def _refuse_overridden(cfg: DictConfig) -> None:
    """Refuse options that the budget sets, if the user named one or gave another value than the default."""
    defaults = compose("enhance")
    overrides = HydraConfig.get().overrides.task if HydraConfig.initialized() else ()
    named = {override.split("=")[0].lstrip("+") for override in overrides}
    for key in BUDGET_KEYS:
        if key in named or cfg[key] != defaults[key]:
            raise InputError(key, f"is {cfg[key]!r} together with budget_ms, which sets it", "give one of the two")
