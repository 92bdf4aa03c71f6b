"""``enhance budget_ms=``: the best setting that is known to keep within a time, on this machine and at this size.

The settings and their times come from the validation scenes of ``gaussian-enhancer tradeoff``, measured on another
machine as a rule. How much faster or slower this one is, is measured: the cheapest setting is timed on the first view.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from hydra import compose
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf, open_dict
from rich.console import Console

from gaussian_enhancer.checkpoint import SHIPPED
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.presets import Preset, choose, read_presets
from gaussian_enhancer.metrics.cost import timed
from gaussian_enhancer.scene.in_memory import single
from gaussian_enhancer.scene.rendered import RenderedSet

OFFERS = SHIPPED / "settings.json"

CHOSEN = ("weights", "max_references", "precision", "tile")
"""What a budget decides and therefore cannot be given beside it."""


def within_budget(
    cfg: DictConfig, ready: Callable[[DictConfig, torch.device], Any], device: torch.device, console: Console
) -> DictConfig:
    """The configuration with the best setting that keeps within its ``budget_ms``; as it is without one.

    What is returned is what a user would write who asks for that setting by name, and is filed as such.

    Args:
        cfg: of the job enhance.
        ready: gives an `SetEnhancer`, the job's input and more for a configuration.
        device: where the network runs.
        console: is told what was chosen and why.

    Raises:
        InputError: no setting keeps within it, none was measured, or what it decides is given beside it.
    """
    if cfg.get("budget_ms") is None:
        return cfg
    budget = cfg.budget_ms
    if isinstance(budget, bool) or not isinstance(budget, int | float) or not 0 < budget < math.inf:
        raise InputError("budget_ms", f"is {budget!r}", "give milliseconds an image, above 0")
    _refuse_given(cfg)
    presets = read_presets(OFFERS)
    enhancer, task, *_ = ready(_with(cfg, presets[0]), device)
    milliseconds, megapixels = calibrated(enhancer, task.rendered)
    speed = milliseconds / (presets[0].milliseconds * megapixels)
    chosen, told = choose(presets, float(budget), megapixels, speed)
    console.print(told, highlight=False, soft_wrap=True)
    return _with(cfg, chosen)


def calibrated(enhancer: SetEnhancer, rendered: RenderedSet) -> tuple[float, float]:
    """Milliseconds of the first view, the median of three after a warm-up, and the megapixels of what comes out.

    Args:
        enhancer: of the cheapest setting.
        rendered: what the job enhances.

    Raises:
        InputError: there is no view, or it cannot be read.
    """
    if not rendered.targets:
        raise InputError(rendered.name, "has no render to enhance", "render held-out views first")
    (first,) = single(replace(rendered, targets=rendered.targets[:1]), 1)
    height, width = next(enhancer(first)).image.shape[-2:]
    timing = timed({"": lambda: next(enhancer(first))}, repeats=3, warm_up=0, device=enhancer.device)[""]
    return timing.milliseconds, height * width / 1e6


def _with(cfg: DictConfig, offer: Preset) -> DictConfig:
    """The configuration with an offer's setting, as if the user had asked for it."""
    chosen = OmegaConf.merge(cfg, OmegaConf.from_dotlist(list(offer.enhance)))
    if not isinstance(chosen, DictConfig):
        raise TypeError("a job's configuration is a mapping")
    with open_dict(chosen):
        chosen.update({"weights": offer.weights, "budget_ms": None})
    return chosen


def _refuse_given(cfg: DictConfig) -> None:
    """Refuse what the budget decides where the user gives it, by another value than the default or by name."""
    defaults = compose("enhance")
    words = HydraConfig.get().overrides.task if HydraConfig.initialized() else ()
    named = {word.split("=")[0].lstrip("+") for word in words}
    for key in CHOSEN:
        if key in named or cfg[key] != defaults[key]:
            raise InputError(key, f"is {cfg[key]!r} beside budget_ms, which decides it", "give one of the two")
