"""``gaussian-enhancer sampler``: distribution of sampled codes against codes of real renders.

One row for each number of steps and kind of sampling, on crops of held-out views, all snapshots: spread of sampled
codes over that of the extractor's (1 is right), root mean square change L - G over that of real renders R - G, and
milliseconds. Stage 1 is the gate calibrated on the renders of the view itself, which isolates the effect of stage 2.
Runs must be validation runs (docs/data.md).
"""

import time
from collections.abc import Callable, Iterator
from typing import Any

import torch
from omegaconf import DictConfig
from torch import Tensor

from ablations.realism.realism import real_renders
from ablations.study.engine import Study, job
from ablations.study.fits import finished_fits
from ablations.study.processor import refuse_gpu
from gaussian_enhancer.degrade.artefacts.rng import spawn
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.adaptive import calibrate_gate
from gaussian_enhancer.degrade.gates.fingerprint import measure_fingerprint
from gaussian_enhancer.degrade.generative.diffusion import Sampler
from gaussian_enhancer.degrade.generative.weights import load_model
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.errors import InputError

CROP = 128
"""Side of the crops, pixels."""
SAMPLERS = {
    **{f"DDIM, {steps} steps": Sampler(steps) for steps in (1, 2, 4, 8, 16)},
    **{f"ancestral, {steps} steps": Sampler(steps, noise=1.0) for steps in (1, 2, 4, 8, 16)},
    "posterior mean, 4 steps": Sampler(4, mean=True),
}


def measured(cfg: DictConfig) -> Iterator[dict[str, Any]]:
    """One row a sampler.

    Args:
        cfg: conf/sampler.yaml, composed.

    Raises:
        InputError: weights or runs cannot be used.
    """
    views = [render.target for render in real_renders(finished_fits(cfg.runs), cfg.renders)]
    photo, real = (torch.stack([_crop(getattr(view, side)) for view in views]) for side in ("read_photo", "read"))
    gate = calibrate_gate(
        measure_fingerprint(list(real), list(photo)), list(photo[:4]), torch.Generator().manual_seed(0), held_out={}
    )
    manual = Simulator(gate)(View(photo), torch.Generator().manual_seed(0)).image
    model = load_model(cfg.generator_weights).model
    with torch.no_grad():
        extractor_spread = model.extractor(manual, real).grid.std((0, 2, 3))
        for name, sampler in SAMPLERS.items():
            started = time.perf_counter()
            codes = model.sample(manual, sampler, spawn(len(manual), torch.Generator().manual_seed(1)))
            seconds = time.perf_counter() - started
            simulated = model.combine(manual, codes, spawn(len(manual), torch.Generator().manual_seed(2))).clamp(0, 1)
            change = [float((image - photo).square().mean().sqrt()) for image in (simulated, real)]
            spread = float((codes.grid.std((0, 2, 3)) / extractor_spread).mean())
            row = {"sampler": name, "spread": spread, "change": change[0] / change[1]}
            yield {**row, "milliseconds": 1e3 * seconds / len(manual), "views": len(manual)}


def _crop(read: Callable[[], Tensor]) -> Tensor:
    image = read()
    if min(image.shape[1:]) < CROP:
        size = f"{image.shape[2]}x{image.shape[1]}"
        raise InputError("runs", f"hold a view of {size}", f"give views of at least {CROP}x{CROP}")
    return image[:, :CROP, :CROP]


def study(cfg: DictConfig, device: torch.device) -> Study[DictConfig]:
    """All samplers on the same crops."""
    refuse_gpu(device)
    return Study([cfg], measured, ("sampler",))


run = job(study)
