import torch

from gaussian_enhancer.degrade.artefacts.noise import MAX_SIGMA, noise, smooth_noise
from gaussian_enhancer.degrade.artefacts.region import soft_region
from gaussian_enhancer.degrade.artefacts.view import View
from support.generators import spawn_seeded


def change(strength, size=(64, 64), level=0.5, seed=0, count=4):
    grey = torch.full((count, 3, *size), level)
    generators = spawn_seeded(count, seed)
    return noise(View(grey), torch.full((count,), strength), generators).image - grey


def test_blobs_have_the_variance_of_white_noise_and_correlated_neighbours():
    white = torch.randn(1, 3, 256, 256, generator=torch.Generator().manual_seed(0))
    inner = smooth_noise(white)[..., 4:-4, 4:-4]
    torch.testing.assert_close(inner.std(), white.std(), rtol=0.03, atol=0)
    neighbours = (inner[..., 1:] * inner[..., :-1]).mean() / inner.square().mean()
    # A Gaussian of one pixel is correlated with itself by exp(-1/4) one pixel on.
    torch.testing.assert_close(neighbours, torch.tensor(0.7788), rtol=0, atol=0.02)


def test_is_linear_in_the_strength_on_middle_grey():
    torch.testing.assert_close(change(0.25), change(1.0) / 4, rtol=0, atol=1e-6)


def test_is_as_loud_as_it_says_where_the_region_is():
    region = soft_region(64, 64, spawn_seeded(16), torch.zeros(1))
    loudness = change(1.0, count=16) / (MAX_SIGMA * region)
    torch.testing.assert_close(loudness[region.expand(-1, 3, -1, -1) > 0.5].std(), torch.tensor(1.0), rtol=0.05, atol=0)


def test_has_no_bias_and_independent_channels():
    drawn = change(1.0, count=16)
    assert abs(float(drawn.mean())) < 1e-3
    correlation = torch.corrcoef(drawn.transpose(0, 1).flatten(1))
    assert (correlation - torch.eye(3)).abs().max() < 0.02


def test_stops_at_black_and_white():
    assert change(1.0, level=0.0).min() >= 0
    assert change(1.0, level=1.0).max() <= 0
