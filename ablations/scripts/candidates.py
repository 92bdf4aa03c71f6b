"""``gaussian-enhancer candidates``: which weights to ship: gains of several on the same validation views.

Weights are shipped names or files; a row is named by the shipped name, or by the folder of its training without the
digest. Runs must be validation runs (docs/data.md), since test scenes may not decide which weights are shipped.
"""

from collections.abc import Sequence
from pathlib import Path

import torch
from omegaconf import DictConfig

from ablations.study.engine import Study, job
from ablations.study.fits import finished_fits
from ablations.study.gains import gain_study
from ablations.study.methods import name_of
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.weights import Pretrained, load_weights
from gaussian_enhancer.scene.frozen import refuse_frozen


def load_candidates(candidates: Sequence[str]) -> dict[str, Pretrained]:
    """Load each candidate, by the name of its row.

    Raises:
        InputError: two have the same name, or one enlarges its renders.
    """
    by_name: dict[str, Pretrained] = {}
    for weights in candidates:
        pretrained, name = load_weights(weights), name_of(weights)
        if name in by_name:
            raise InputError(weights, f"is the second row {name}", "label trainings differently")
        if (scale := pretrained.network.scale) != 1:
            raise InputError(weights, f"enlarges {scale} times", "give weights of the render's own size")
        by_name[name] = pretrained
    return by_name


def load_enhancers(candidates: Sequence[str], device: torch.device | None = None) -> dict[str, SetEnhancer]:
    """Each candidate as the job enhance would use it; see `load_candidates` for what is refused."""
    return {
        name: EnhancementOptions().enhancer(pretrained, pretrained.reference_config, device)
        for name, pretrained in load_candidates(candidates).items()
    }


def study(cfg: DictConfig, device: torch.device) -> Study[Path]:
    """The candidates' gains.

    Raises:
        InputError: weights or runs cannot be compared, or a run is of a test scene.
    """
    refuse_frozen(finished_fits(cfg.runs))
    return gain_study(load_enhancers(cfg.weights, device), cfg, device)


run = job(study)
