"""The paper's five variants, ours and the paper's own, compose with the recipes and build what they name."""

import pytest
from omegaconf import DictConfig

from gaussian_enhancer.runs.instantiate import build
from support.job_config import job_config

TYPES = {"blur", "noise", "sensor", "jpeg", "downsampling", "needle", "banding", "cloudy", "floater", "colour"}
"""The paper's artefacts; ``displacement`` is ours."""
VARIANTS = [
    ("ge", "SIF", False),
    ("ge_tsds", "SIF", True),
    ("ge_ssif", "SSIFLR", False),
    ("gepp_lr", "SSIFLR", True),
    ("gepp_sr", "SSIFSR", True),
]
"""Each with its network and whether it has the second stage."""


def composed(*overrides: str) -> DictConfig:
    return job_config("train", *overrides, "size=tiny")


@pytest.mark.parametrize(("variant", "network", "two_stages"), VARIANTS)
@pytest.mark.parametrize("mode", ["ours", "paper"])
def test_a_variant_is_what_the_paper_calls_so(variant, network, two_stages, mode):
    ours = mode == "ours"
    recipe = {True: "ssif_sr", False: "lr"} if ours else {True: "paper_sr", False: "paper"}
    name = variant if ours else f"paper_{variant}"
    cfg = composed(f"+recipe={recipe[variant == 'gepp_sr']}", f"+ablation/variant={name}")
    built = build(cfg.fusion)
    assert type(built).__name__ == (network if ours else f"Paper{network}")
    assert cfg.label == name
    assert cfg.data.simulation.share == 1.0
    second = ("diffused" if ours else "paired_or_diffused") if two_stages else "NoSecondStage"
    assert cfg.generator._target_.rpartition(".")[2] == second
    on = {name for name, switched in cfg.gate.types.items() if switched}
    assert on == TYPES - (set() if two_stages else {"colour"}) | ({"displacement"} if ours else set())
    assert bool(cfg.reference_config.get("fine", False)) is (built.scale == 4)


@pytest.mark.parametrize("recipe", ["paper", "paper_sr"])
def test_the_papers_recipe_adds_nothing_of_ours(recipe):
    cfg = composed(f"+recipe={recipe}")
    augmentation = build(cfg.data.augmentation)
    assert augmentation.every_reference
    assert augmentation.drop_all == augmentation.drop_renders == augmentation.exposure == augmentation.light == 0
    assert cfg.optimizer._target_ == "torch.optim.Adam"
    assert (cfg.optimizer.lr, cfg.data.loading.batch_size, cfg.trainer.max_steps) == (5e-4, 4, 300_000)
    assert cfg.lr_scheduler.T_max == cfg.trainer.max_steps
    assert list(build(cfg.loss).terms) == ["charbonnier"]
    assert build(cfg.callbacks.ema.multi_avg_fn).decay == 0
    assert cfg.coarse == 0
