"""The job ``train_confidence``: train the change confidence of weights on fits with held-out views."""

from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, open_dict
from rich.console import Console
from rich.progress import track

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.checkpoint import WEIGHTS, checkpoint_digest, find_checkpoint
from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import InputError, refuse_unknown
from gaussian_enhancer.files import write_json
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.weights import (
    Pretrained,
    build_reference_config,
    load_weights,
    reference_config_of,
    save_weights,
)
from gaussian_enhancer.runs.instantiate import plain_values
from gaussian_enhancer.runs.run import open_run
from gaussian_enhancer.runs.runtime import start
from gaussian_enhancer.scene.frozen import refuse_untrained
from gaussian_enhancer.train.confidence import measure_views, train_confidence


def run(cfg: DictConfig) -> None:
    """Enhance the held-out views, train the change confidence, and write ``weights.safetensors`` and its card.

    Args:
        cfg: see ``conf/train_confidence.yaml``.

    Raises:
        InputError: weights or fits cannot be used, training on a scene is not allowed, or a file cannot be written.
    """
    refuse_untrained([*cfg.fits, *(fit for fold in cfg.folds for fit in fold.fits)])
    digests = {
        "weights": checkpoint_digest(find_checkpoint(cfg.weights)),
        "folds": [checkpoint_digest(find_checkpoint(fold.weights)) for fold in cfg.folds],
    }
    named_cfg = cfg.copy()
    with open_dict(named_cfg):
        named_cfg["made_of"] = digests
    job = open_run(named_cfg, "train_confidence", Path(cfg.weights).stem)
    device = start(cfg.runtime)
    console = Console(stderr=True)
    weights = job.folder / WEIGHTS
    if job.done:
        print_line(console, f"trained already: {weights}")
        return
    pretrained = load_weights(cfg.weights)
    if pretrained.network.scale > 1 or not pretrained.reference_config.references:
        raise InputError("weights", "are not for enhancement by references", "give weights such as lr_tiny")
    reference_config = _with_warp_options(pretrained.reference_config, plain_values(cfg.warp))
    enhancers = _enhancers(cfg, pretrained, reference_config, device)
    weights_and_fits = [(cfg.weights, Path(fit)) for fit in cfg.fits]
    weights_and_fits += [(fold.weights, Path(fit)) for fold in cfg.folds for fit in fold.fits]
    tracked = track(weights_and_fits, "enhance", console=console, transient=True, disable=not cfg.runtime.progress)
    fits = [list(measure_views(folder, enhancers[name])) for name, folder in tracked]
    fits, count = [views for views in fits if views], sum(map(len, fits))
    if not count:
        raise InputError("fits", "hold no held-out views", "name fitted runs with held-out photos")
    confidence = train_confidence(fits, cfg.hidden, cfg.steps, cfg.harm, cfg.block_harm, cfg.seed)
    confidence_card = {
        **plain_values(cfg.card),
        "fits": [folder.name for _, folder in weights_and_fits],
        **digests,
        "views": count,
        "warp": plain_values(cfg.warp),
        **{name: cfg[name] for name in ("steps", "harm", "block_harm", "seed")},
    }
    card = {**pretrained.card, "reference_config": reference_config_of(reference_config), "confidence": confidence_card}
    save_weights(weights, pretrained.network, reference_config, card, confidence)
    write_json(job.folder / "card.json", card, indent=2)
    job.finish()
    print_line(console, f"{weights}: learnt from {count} views")


def _enhancers(
    cfg: DictConfig, pretrained: Pretrained, reference_config: ReferenceConfig, device: torch.device
) -> dict[str, SetEnhancer]:
    """Enhancers at full strength with the weights and with those of each fold, by the weights' name.

    Raises:
        InputError: weights of a fold cannot be read or have another design.
    """
    full_strength = EnhancementOptions(strength=1.0, confidence=False)
    enhancers = {cfg.weights: full_strength.enhancer(pretrained, reference_config, device)}
    for fold in cfg.folds:
        fold_weights = load_weights(fold.weights)
        if fold_weights.network.design != pretrained.network.design:
            raise InputError("folds", f"name {fold.weights}, of another design", "give weights of one design")
        enhancers[fold.weights] = full_strength.enhancer(fold_weights, reference_config, device)
    return enhancers


def _with_warp_options(config: ReferenceConfig, options: dict[str, Any]) -> ReferenceConfig:
    """The reference configuration with some options of its warp replaced.

    Raises:
        InputError: the warp has no such option, or refuses the value.
    """
    values = reference_config_of(config)
    refuse_unknown("warp", options, values["warp"].keys() - {"kind"})
    try:
        return build_reference_config({**values, "warp": {**values["warp"], **options}})
    except ValueError as error:
        raise InputError("warp", f"is {options} ({error})", "give values as conf/alignment has them") from None
