import pytest
import torch

from ablations.scripts.diversity import diversity
from gaussian_enhancer.errors import InputError


def test_equal_samples_have_none_and_known_ones_their_standard_deviation():
    one = torch.rand(3, 8, 9)
    assert diversity(one.expand(4, 3, 8, 9)) == pytest.approx(0, abs=1e-7)
    pair = torch.stack([one, one + 0.1])
    assert diversity(pair) == pytest.approx(0.1 / 2**0.5, rel=1e-5)  # ddof 1


def test_grows_in_proportion_and_is_the_same_for_residuals():
    generator = torch.Generator().manual_seed(0)
    samples, photo = torch.randn(5, 3, 16, 16, generator=generator), torch.rand(3, 16, 16, generator=generator)
    assert diversity(2 * samples) == pytest.approx(2 * diversity(samples))
    assert diversity(samples - photo) == pytest.approx(diversity(samples), rel=1e-5)
    assert diversity(samples) == pytest.approx(0.94, abs=0.03)  # E[s] of five normal samples


def test_refuses_a_single_sample():
    with pytest.raises(InputError, match="at least two"):
        diversity(torch.rand(1, 3, 4, 4))
