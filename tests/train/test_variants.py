"""The paper's five variants compose with the recipes and build what they name."""

import pytest
from hydra import compose, initialize_config_dir

from gaussian_enhancer.runs.instantiate import build
from support import paths

CONF = paths.CONF


@pytest.mark.parametrize(
    ("variant", "recipe", "network", "second", "colour"),
    [
        ("ge", "lr", "SIF", "NoSecondStage", False),
        ("ge_tsds", "lr", "SIF", "diffused", True),
        ("ge_ssif", "lr", "SSIFLR", "NoSecondStage", False),
        ("gepp_lr", "lr", "SSIFLR", "diffused", True),
        ("gepp_sr", "ssif_sr", "SSIFSR", "diffused", True),
    ],
)
@pytest.mark.parametrize("mode", ["ours", "paper"])
def test_a_variant_is_what_the_paper_calls_so(variant, recipe, network, second, colour, mode):
    with initialize_config_dir(CONF, version_base="1.3"):
        cfg = compose("train", [f"+recipe={recipe}", f"+ablation/variant={variant}", f"mode={mode}", "size=tiny"])
        built = build(cfg.fusion)
    assert type(built).__name__ == network
    assert cfg.data.simulation.share == 1.0
    assert cfg.generator._target_.endswith(second)
    assert cfg.gate.types.colour is colour
    assert bool(cfg.reference_config.get("fine", False)) is (built.scale == 4)
