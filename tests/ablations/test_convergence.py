"""The study of gain against the age of a splat."""

import pytest
import torch

from ablations.scripts.convergence import TITLES, enhancers, harm, role_of
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import load_weights


def test_a_method_names_weights_strength_and_whether_colours_are_completed() -> None:
    made = enhancers(["lr_tiny", "lr_tiny@0.5", "lr_tiny@1:plain"])
    own = load_weights("lr_tiny").strength
    assert list(made) == [f"lr_tiny@{own:g}", "lr_tiny@0.5", "lr_tiny@1 plain"]
    kept = [(enhancer.strength, enhancer.colour_completion) for _, enhancer in made.values()]
    assert kept == [(own, True), (0.5, True), (1.0, False)]


def test_another_ending_is_refused() -> None:
    with pytest.raises(InputError, match="write :plain"):
        enhancers(["lr_tiny@1:fast"])


def test_every_role_has_a_title_and_an_unknown_capture_none() -> None:
    assert TITLES[role_of("plush")] == "Validation captures"
    assert TITLES[role_of("fox")] == "Test captures"
    with pytest.raises(InputError, match="has no role"):
        role_of("garden")


def test_harm_counts_the_blocks_that_lose() -> None:
    photo, render = torch.zeros(3, 32, 32), torch.full((3, 32, 32), 0.2)
    enhanced = render.clone()
    enhanced[:, :16, :16] = 0.4
    found = harm(render, enhanced, photo)
    assert found["blocks_harmed"] == 0.25
    assert found["error_removed"] == 0
    assert found["error_added"] == pytest.approx(0.75)
