"""``gaussian-enhancer leave_one_out``: do training views predict how much of a change to apply?

The strength could be chosen for each splat by its own training views: each one is enhanced with the photos of the
others and compared with its own photo. This works only if the best share of the change is the same on training and
held-out views. The study measures both for the same fit. The best share of a view is (c, w) / (c, c), where c is the
change and w the difference of the photo, in the render's exposure, to the render.
"""

from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path

import torch
from omegaconf import DictConfig

from ablations.study.engine import Study, job
from ablations.study.fits import finished_fits, scene_of
from ablations.study.methods import load_enhancer
from ablations.study.roles import role_of
from gaussian_enhancer.align.exposure import match_exposure
from gaussian_enhancer.align.references import ReferencePool, build_network_input, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.metrics.image_quality import psnr
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.scene.renders import read_run, run_steps


def measured(view: RenderedView, pool: ReferencePool, enhancer: SetEnhancer) -> dict[str, object]:
    """The render's PSNR, the gain, and the share of the change that would have been best, for one view.

    Args:
        view: with a photo; it is never its own reference.
        pool: training views.
        enhancer: enhances the view.

    Raises:
        InputError: the view has no photo.
    """
    if view.read_photo is None:
        raise InputError(view.name, "has no photo to compare with", "give runs with held-out photos")
    target, photo = read_target(view), view.read_photo()
    truth = match_exposure(photo, target.image)
    enhanced = enhancer.enhance(build_network_input(target, enhancer.reference_config.align(target, view, pool)))[0]
    change, ideal_change = enhanced - target.image, truth - target.image
    share = float((change * ideal_change).sum() / change.square().sum().clamp_min(1e-9))
    raw = float(psnr(target.image, truth))
    return {"view": view.name, "raw": raw, "gain": float(psnr(enhanced, truth)) - raw, "best_share": share}


def study(cfg: DictConfig, device: torch.device) -> Study[Path]:
    """Held-out and training views of each fit's last step.

    Raises:
        InputError: a pattern names no finished run.
    """
    options = EnhancementOptions(strength=1.0, confidence=cfg.confidence)
    load = cache(partial(load_enhancer, cfg.weights, options, device))  # only if something has to be measured

    def measure(run: Path) -> Iterator[dict[str, object]]:
        (digest, enhancer), step = load(), run_steps(run)[-1]
        rendered, scene = read_run(run, step), scene_of(run)
        pool = ReferencePool(rendered.references)
        about = {"role": role_of(scene), "scene": scene, "run": run.name, "step": step, "weights": digest}
        for side, views in (("held out", rendered.targets), ("training", rendered.references)):
            for view in views[:: cfg.every]:
                yield {**about, "side": side, **measured(view, pool, enhancer)}

    fits = finished_fits(cfg.runs) if cfg.runs else []
    return Study(fits, measure, ("run", "side", "view"), ("best_share",))


run = job(study)
