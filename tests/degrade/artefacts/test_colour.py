import pytest
import torch

from gaussian_enhancer.degrade.artefacts.colour import change_tone, coarse_ycbcr, colour, palette, quantise
from gaussian_enhancer.degrade.artefacts.view import View
from support.generators import spawn_seeded


def noise(count=2, size=16):
    return torch.rand(count, 3, size, size, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def test_quantised_values_are_the_nearest_multiples():
    values = torch.linspace(-1, 1, 201, dtype=torch.float64).reshape(1, 1, 1, -1)
    step = torch.full((1, 1, 1, 1), 0.3, dtype=torch.float64)
    after = quantise(values, step)
    torch.testing.assert_close(after / 0.3, (after / 0.3).round())
    assert (after - values).abs().max() <= 0.15 + 1e-12
    assert torch.equal(quantise(values, torch.zeros_like(step)), values)


def test_a_palette_has_sixteen_levels_at_strength_1():
    image = noise()
    assert len(palette(image, torch.ones(2, dtype=torch.float64)).mul(15).round(decimals=6).unique()) == 16


def test_coarse_ycbcr_keeps_greys_grey_and_luma_close():
    grey = torch.linspace(0, 1, 64, dtype=torch.float64).expand(1, 3, 1, -1)
    one = torch.ones(1, dtype=torch.float64)
    after = coarse_ycbcr(grey, one)
    torch.testing.assert_close(after, after[:, :1].expand(-1, 3, -1, -1), rtol=0, atol=1e-9)
    assert (after - grey).abs().max() <= 1 / 128 + 1e-9
    assert len(after.round(decimals=6).unique()) == 64
    change = coarse_ycbcr(noise(1), one) - noise(1)
    luma = torch.tensor([0.299, 0.587, 0.114], dtype=torch.float64)[:, None, None]
    assert change.abs().mean() > 2 * (change * luma).sum(1).abs().mean()


def test_toning_is_a_gamma_and_a_gain_within_their_range():
    image = torch.tensor([0.25, 0.5, 1.0], dtype=torch.float64).expand(16, 3, 1, 3)
    strength = torch.full((16,), 0.5, dtype=torch.float64)
    after = change_tone(image, strength, spawn_seeded(16))
    gain = after[..., 2]
    gamma = torch.log(after[..., 1] / gain) / torch.log(image[..., 1])
    torch.testing.assert_close(gain * image[..., 0] ** gamma, after[..., 0])
    for value in (gain, gamma):
        assert 0.015 < (value - 1).abs().max() <= 0.025
        assert value.std() > 0.005


@pytest.mark.parametrize("way", [palette, coarse_ycbcr])
def test_rounding_passes_the_gradient_straight_through(way):
    image = (0.3 + 0.4 * noise()).requires_grad_()
    way(image, torch.full((2,), 0.5, dtype=torch.float64)).sum().backward()
    torch.testing.assert_close(image.grad, torch.ones_like(image))


def test_gradcheck_of_toning():
    image = noise(1, 3).requires_grad_()
    one = torch.ones(1, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: change_tone(x, one, spawn_seeded(1)), (image,))


def test_all_three_ways_occur():
    image = noise(1).expand(24, -1, -1, -1)
    strength = torch.ones(24, dtype=torch.float64)
    after = colour(View(image), strength, spawn_seeded(24)).image
    is_palette = (after == palette(image, strength)).flatten(1).all(1)
    is_coarse = (after == coarse_ycbcr(image, strength)).flatten(1).all(1)
    assert min(int(is_palette.sum()), int(is_coarse.sum()), int((~is_palette & ~is_coarse).sum())) >= 3
