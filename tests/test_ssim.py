"""One definition of SSIM, held to torchmetrics' where windows are whole, and to its own other way of filtering."""

import pytest
import torch

from gaussian_enhancer.loss.terms import dssim
from gaussian_enhancer.ssim import RADIUS, filter_windowed, ssim_map, window_weights


@pytest.fixture
def pair():
    draw = torch.Generator().manual_seed(0)
    photo = torch.rand(2, 3, 24, 31, generator=draw, dtype=torch.float64)
    return (photo + 0.2 * torch.rand(photo.shape, generator=draw, dtype=torch.float64)).clamp(0, 1), photo


def test_equals_torchmetrics_where_the_window_is_whole(pair):
    from torchmetrics.functional.image import structural_similarity_index_measure

    _, theirs = structural_similarity_index_measure(
        *pair, gaussian_kernel=True, sigma=1.5, kernel_size=11, data_range=1.0, return_full_image=True
    )
    inner = (..., slice(RADIUS, -RADIUS), slice(RADIUS, -RADIUS))
    torch.testing.assert_close(ssim_map(*pair)[inner], theirs[inner], rtol=0, atol=1e-6)


def test_band_matrices_filter_as_convolutions_do(pair):
    torch.testing.assert_close(1 - dssim(*pair), ssim_map(*pair), rtol=0, atol=1e-12)


def test_the_window_sums_to_one_and_is_empty_outside(pair):
    weights = window_weights(torch.arange(-9, 10, dtype=torch.float64))
    assert float(weights.sum()) == pytest.approx(1, abs=1e-12)
    assert not weights[:4].any()
    assert not weights[-4:].any()
    flat = torch.ones(1, 16, 16, dtype=torch.float64)
    assert float(filter_windowed(flat)[0, 8, 8]) == pytest.approx(1, abs=1e-12)
    assert float(filter_windowed(flat)[0, 0, 0]) == pytest.approx(
        float(window_weights(torch.arange(0.0, 6)).sum()) ** 2, abs=1e-6
    )


def test_equal_images_are_wholly_similar(pair):
    torch.testing.assert_close(ssim_map(pair[1], pair[1]), torch.ones_like(pair[1]), rtol=0, atol=1e-12)
