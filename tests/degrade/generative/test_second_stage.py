import json

import pytest
import torch

from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.generative.diffusion import Sampler
from gaussian_enhancer.degrade.generative.second_stage import (
    DiffusedGenerator,
    FactorDesign,
    FactorModel,
    PairedGenerator,
    PairedOrDiffusedGenerator,
)
from gaussian_enhancer.degrade.generative.weights import load_model, save_model
from gaussian_enhancer.errors import InputError
from support.generators import spawn_seeded

SMALL = {"vector": 4, "grid": 2, "widths": (8, 8), "code_width": 8, "code_blocks": 1}


def model(trained: bool = True, **choices: object) -> FactorModel:
    """A small model; a trained one has a head that is no longer zero."""
    torch.manual_seed(0)
    made = FactorModel(FactorDesign(**{**SMALL, **choices}))
    if trained:
        torch.nn.init.normal_(made.combiner.head.weight, std=0.1)
    return made.eval()


def view(count: int = 2, height: int = 24, width: int = 32) -> View:
    generator = torch.Generator().manual_seed(3)
    image = torch.rand(count, 3, height, width, generator=generator)
    return View(image, 1 + torch.rand(count, 1, height, width, generator=generator))


def test_untrained_second_stage_returns_stage_one():
    for second in (DiffusedGenerator(model(trained=False)), PairedGenerator(model(trained=False))):
        # Not to the last digit: a pixel that is read at its own place is interpolated all the same.
        made = second(view(), spawn_seeded(2), view().image).image
        torch.testing.assert_close(made, view().image, rtol=0, atol=1e-5)


@pytest.mark.parametrize("parts", [{"vector": 4, "grid": 2}, {"vector": 4, "grid": 0}, {"vector": 0, "grid": 2}])
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (17, 33)])
def test_any_size_and_either_part_alone(parts, size):
    second = DiffusedGenerator(model(**parts))
    made = second(view(1, *size), spawn_seeded(1)).image
    assert made.shape == (1, 3, *size)
    assert made.isfinite().all()
    assert 0 <= made.min() <= made.max() <= 1


def test_samples_differ_by_seed_and_repeat():
    second = DiffusedGenerator(model())
    first, again, other = (second(view(), spawn_seeded(2, seed=seed)).image for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert (first - other).abs().mean() > 1e-3


def test_batch_is_its_samples_one_by_one():
    second = DiffusedGenerator(model())
    together = second(view(3), spawn_seeded(3)).image
    alone = [second(view(3)[torch.tensor([i])], [spawn_seeded(3)[i]]).image for i in range(3)]
    torch.testing.assert_close(together, torch.cat(alone), rtol=0, atol=1e-5)


def test_depth_stays():
    assert torch.equal(DiffusedGenerator(model())(view(), spawn_seeded(2)).depth, view().depth)


def test_grid_says_where():
    """A change of one cell of the code changes the view near that cell alone."""
    made = model(vector=4, grid=2)
    manual, noise = view(1, 96, 96).image, torch.zeros(1, 1, 96, 96)
    factors = made.extractor(manual, manual.flip(3))
    moved = made.extractor(manual, manual.flip(3))
    moved.grid[..., 0, 0] += 3
    change = (made.combiner(manual, factors, noise) - made.combiner(manual, moved, noise)).abs().mean(1)[0]
    assert change[:8, :8].mean() > 1e-4
    assert change[88:, 88:].max() == 0


def test_paired_needs_real_renders():
    with pytest.raises(InputError, match="real renders"):
        PairedGenerator(model())(view(), spawn_seeded(2))


def test_a_real_render_is_read_where_there_is_one_and_factors_are_sampled_where_there_is_none():
    made, real = model(), view().image.flip(3)
    either = PairedOrDiffusedGenerator(made)
    paired, sampled = (
        second(view(), spawn_seeded(2), given).image
        for second, given in ((PairedGenerator(made), real), (DiffusedGenerator(made), None))
    )
    assert torch.equal(either(view(), spawn_seeded(2), real).image, paired)
    assert torch.equal(either(view(), spawn_seeded(2)).image, sampled)
    assert (paired - sampled).abs().max() > 1e-3


@pytest.mark.parametrize("choices", [{"vector": 0, "grid": 0}, {"grid": -1}, {"schedule": "steep"}])
def test_impossible_designs_are_refused(choices):
    with pytest.raises(InputError):
        FactorDesign(**choices)


def test_weights_round_trip(tmp_path):
    saved = model(schedule="linear")
    saved.grid_scale += 1
    save_model(tmp_path / "a.safetensors", saved, {"by": "test"})
    loaded = load_model(tmp_path / "a.safetensors")
    assert loaded.card == {"by": "test"}
    assert loaded.model.design.schedule == "linear"
    sampler = Sampler(2)
    expected, found = (DiffusedGenerator(m, sampler)(view(), spawn_seeded(2)).image for m in (saved, loaded.model))
    torch.testing.assert_close(found, expected, rtol=0, atol=5e-3)


def test_weights_of_another_kind_or_design_are_refused(tmp_path):
    from safetensors.torch import load_file, save_file

    with pytest.raises(InputError, match="format"):
        load_model("lr_tiny")
    path = tmp_path / "a.safetensors"
    save_model(path, model(), {})
    design = {"vector": 10**9, "grid": 2, "widths": [8, 8], "blocks": 1, "code_width": 8, "code_blocks": 1}
    metadata = {"format": "gaussian-enhancer simulator 1", "card": "{}", "design": json.dumps(design)}
    save_file(load_file(path), path, metadata)
    with pytest.raises(InputError, match="a simulator that this version does not support"):
        load_model(path)
