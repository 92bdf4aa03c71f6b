"""``gaussian-enhancer already_good``: can blocks that need no change be recognised before enhancement?

The references' own errors are the predictor. For each view, the whole image is enhanced. Then blocks of 16x16 pixels
are replaced by the render in the order of a predicted error, and the loss of PSNR against the enhanced image is
measured. The predicted error of a block is the mean difference between a reference's photo and the splat's render of
the same view, warped to the target on a coarse grid; blocks that no reference sees come last. The order by the true
gain, which is unknown in use, is the bound for any predictor. Runs must be training or validation scenes, since
thresholds are chosen from the result.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch
import torch.nn.functional as F
from omegaconf import DictConfig
from torch import Tensor

from ablations.study.engine import Study, job
from ablations.study.fits import finished_fits, scene_of
from gaussian_enhancer.align.alignment import LoadedView
from gaussian_enhancer.align.coarse_visibility import coarsen
from gaussian_enhancer.align.exposure import match_exposure
from gaussian_enhancer.align.references import read_target
from gaussian_enhancer.align.reproject import reproject
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.plan import Rules
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.regions import BLOCK
from gaussian_enhancer.infer.weights import Pretrained, load_weights
from gaussian_enhancer.metrics.records import Record
from gaussian_enhancer.scene.frozen import refuse_frozen
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.scene.splits import evenly_spaced
from gaussian_enhancer.types import quantise_8_bit

ALLOWED = 0.02
"""dB that passing blocks through may cost."""


def measure_fit(fit: Path, count: int, pretrained: Pretrained, device: torch.device | None = None) -> Iterator[Record]:
    """One record a view: share of blocks that each order may pass through at a loss of `ALLOWED`, and remaining box."""
    rendered = read_run(fit)
    targets = evenly_spaced(rendered.targets, count)
    rendered = replace(rendered, targets=targets)
    planner = Planner(Rules(references="auto"), pretrained.reference_config, rendered)
    enhancer = SetEnhancer(pretrained.network, pretrained.reference_config, device)
    for view, result in zip(targets, enhancer(rendered, planner), strict=True):
        if view.read_photo is None or result.plan is None:
            continue
        target, photo = read_target(view), view.read_photo()
        before, after = (block_means(((quantise_8_bit(i) - photo) ** 2).mean(0)) for i in (target.image, result.image))
        references = [planner.pool.read(index, False) for index in planner.reference_indices(result.plan) or ()]
        orders = {"predicted": predict_gain(coarsen(target), references, before.shape), "bound": before - after}
        metrics: dict[str, float | None] = {}
        for name, order in orders.items():
            passed = passable(order, before - after, float(after.mean()))
            metrics |= {f"passed by {name}": float(passed.float().mean()), f"box by {name}": bounding_share(~passed)}
        height, width = target.image.shape[-2:]
        yield Record("already_good", fit.name, scene_of(fit), "3dgs", view.name, "", metrics, {}, (width, height))


def predict_gain(target: LoadedView, references: list[LoadedView], shape: torch.Size) -> Tensor:
    """The largest error that a reference shows for each block; infinite where none sees most of it."""
    worst = torch.full(shape, -1.0)
    for reference in references:
        if reference.render is None or reference.camera is None or target.camera is None or target.depth is None:
            raise InputError(reference.name, "has no render, camera or depth", "give runs of the job fit")
        matched = match_exposure(reference.image, reference.render)
        error = (matched - reference.render).abs().mean(0, keepdim=True).expand(3, -1, -1)
        coarse = coarsen(replace(reference, image=error))
        warped = reproject(target.camera, target.depth, coarse.camera, coarse.image, coarse.depth, target.alpha)  # type: ignore[arg-type]
        errors, visible = (
            F.adaptive_avg_pool2d(x[:1], (shape[0], shape[1]))[0] for x in (warped.colour, warped.visibility)
        )
        worst = torch.where(visible > 0.5, torch.maximum(worst, errors / visible), worst)
    return torch.where(worst < 0, math.inf, worst)


def passable(order: Tensor, gain: Tensor, remaining: float) -> Tensor:
    """The first blocks of an order, as many as can be passed through at a loss of `ALLOWED`."""
    indices = order.flatten().argsort()
    lost = gain.flatten()[indices].cumsum(0) / gain.numel()
    allowed = remaining * (10 ** (ALLOWED / 10) - 1)
    count = int((lost <= allowed).long().cumprod(0).sum())
    passed = torch.zeros(gain.numel(), dtype=torch.bool)
    passed[indices[:count]] = True
    return passed.view(gain.shape)


def bounding_share(needed: Tensor) -> float:
    """Area of the smallest rectangle around the needed blocks, as a share of the image."""
    sides = [needed.any(axis).nonzero()[:, 0] for axis in (0, 1)]
    if not len(sides[0]):
        return 0.0
    return float(math.prod(int(side[-1] - side[0]) + 1 for side in sides) / needed.numel())


def block_means(values: Tensor) -> Tensor:
    """Mean over each block."""
    return F.avg_pool2d(values[None, None], BLOCK, ceil_mode=True)[0, 0]


def study(cfg: DictConfig, device: torch.device) -> Study[Path]:
    """The blocks that each order may pass through.

    Raises:
        InputError: a run is of a test scene, or weights or runs cannot be used.
    """
    fits = finished_fits(cfg.runs)
    refuse_frozen(fits, "chosen by")
    pretrained = load_weights(cfg.weights)
    return Study(fits, lambda fit: measure_fit(fit, cfg.views, pretrained, device))


run = job(study)
