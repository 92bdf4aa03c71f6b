"""``gaussian-enhancer guards``: gain and harm at several values of a limit to the change.

Limits to the change protect a view from harm. ``guard`` is ``photo_consistency`` (the largest difference of a reference
to the render, `Reprojected.photo_consistency`; None also switches the check for outliers off), ``colour_clamping`` (the
window that a pixel's colours are clamped to, `SetEnhancer`) or ``strength`` (the share of the change that is applied).
Runs must be validation runs (docs/data.md), since test scenes may not decide limits.
"""

from dataclasses import replace
from pathlib import Path

import torch
from omegaconf import DictConfig

from ablations.scripts.candidates import load_candidates
from ablations.study.engine import Study, job
from ablations.study.fits import finished_fits
from ablations.study.gains import gain_study
from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.weights import Pretrained
from gaussian_enhancer.scene.frozen import refuse_frozen

LIMITS: dict[str, tuple[float | None, ...]] = {
    "photo_consistency": (None, 0.3, 0.2, 0.15, 0.1),
    "colour_clamping": (0, 1, 3, 5, 9),
    "strength": (0.5, 0.8, 1.0),
}
"""Compared values of each guard; None and 0 switch photo-consistency and colour clamping off."""


def guarded_enhancer(
    pretrained: Pretrained, guard: str, limit: int | float | None, device: torch.device | None = None
) -> SetEnhancer:
    """A network with one limit, without the confidence; colour completion and other limits are as in the job enhance.

    Raises:
        InputError: references are not warped, so that they are not checked.
    """
    network, reference_config = pretrained.network, pretrained.reference_config
    if guard == "colour_clamping":
        window = int(limit or 0)
        return SetEnhancer(network, reference_config, device, strength=pretrained.strength, colour_clamping=window)
    if guard == "strength":
        return SetEnhancer(network, reference_config, device, strength=1.0 if limit is None else limit)
    if not isinstance(reference_config.warp, Reprojected):
        raise InputError("weights", "do not warp their references", "give weights with alignment=reprojected")
    checked = replace(reference_config, warp=replace(reference_config.warp, photo_consistency=limit))
    return SetEnhancer(network, checked, device, strength=pretrained.strength)


def study(cfg: DictConfig, device: torch.device) -> Study[Path]:
    """Gains under every limit.

    Raises:
        InputError: weights or runs cannot be compared, or a run is of a test scene.
    """
    refuse_frozen(finished_fits(cfg.runs), "chosen by")
    enhancers = {
        f"{name}, {cfg.guard} {limit}": guarded_enhancer(pretrained, cfg.guard, limit, device)
        for name, pretrained in load_candidates(cfg.weights).items()
        for limit in LIMITS[cfg.guard]
    }
    return gain_study(enhancers, cfg, device)


run = job(study)
