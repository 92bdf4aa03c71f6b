import math

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from gaussian_enhancer.metrics.image_quality import align_colours, psnr, psnr_aligned, ssim
from gaussian_enhancer.splat.fit.similarity import photometric_loss, prepare
from gaussian_enhancer.types import quantise_8_bit


def images(height: int = 24, width: int = 37, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    draw = torch.Generator().manual_seed(seed)
    photo = torch.rand(3, height, width, generator=draw)
    return (photo + 0.2 * torch.randn(3, height, width, generator=draw)).clamp(0, 1), photo


def ssim_by_scipy(image: np.ndarray, photo: np.ndarray) -> float:
    """SSIM written out with scipy's Gaussian filter: radius 5, zeros outside."""

    def blurred(values: np.ndarray) -> np.ndarray:
        filtered = [gaussian_filter(v, 1.5, radius=5, mode="constant", cval=0.0) for v in values]
        return np.stack(filtered)

    a, b = blurred(image), blurred(photo)
    va, vb, ab = blurred(image**2) - a**2, blurred(photo**2) - b**2, blurred(image * photo) - a * b
    return float(((2 * a * b + 1e-4) * (2 * ab + 9e-4) / ((a**2 + b**2 + 1e-4) * (va + vb + 9e-4))).mean())


@pytest.mark.parametrize("size", [(24, 37), (5, 4), (1, 60)])
def test_ssim_equals_an_independent_implementation(size: tuple[int, int]) -> None:
    image, photo = images(*size)
    expected = ssim_by_scipy(image.double().numpy(), photo.double().numpy())
    assert ssim(image, photo) == pytest.approx(expected, abs=1e-9)


def test_ssim_is_the_one_that_fits_are_made_with() -> None:
    image, photo = images()
    loss = photometric_loss(image, prepare(photo), weight=1.0).item()
    assert 1 - loss == pytest.approx(ssim(image, photo), abs=1e-5)


def test_zero_padding_tells_at_the_border() -> None:
    """A window that is cut or mirrored at the border would find a constant shift equally similar everywhere."""
    photo = torch.full((3, 40, 40), 0.5)
    inside = (2 * 0.5 * 0.6 + 1e-4) / (0.5**2 + 0.6**2 + 1e-4)
    assert ssim(photo + 0.1, photo) < inside - 1e-3


def test_equal_images_are_perfect() -> None:
    _, photo = images()
    assert psnr(photo, photo) == math.inf
    assert ssim(photo, photo) == pytest.approx(1, abs=1e-12)
    assert psnr_aligned(photo, photo) == math.inf


def test_psnr_of_a_known_error() -> None:
    photo = torch.full((3, 8, 8), 0.5)
    assert psnr(photo + 0.1, photo) == pytest.approx(20, abs=1e-5)


def test_the_mask_weighs_pixels() -> None:
    photo = torch.zeros(3, 4, 4)
    image = photo.clone()
    image[:, :2] = 0.1
    mask = torch.zeros(1, 4, 4)
    mask[:, :2] = 1
    assert psnr(image, photo, mask) == pytest.approx(20, abs=1e-5)
    assert psnr(image, photo) == pytest.approx(20 + 10 * math.log10(2), abs=1e-5)
    assert psnr(image, photo, 0.3 * mask) == pytest.approx(20, abs=1e-5)
    assert psnr(image, photo, 1 - mask) == math.inf
    assert math.isnan(psnr(image, photo, 0 * mask))


def test_eight_bits_are_those_of_a_file() -> None:
    values = torch.tensor([-1.0, 0.0, 0.4999 / 255, 0.5001 / 255, 0.5, 1.0, 2.0]).expand(3, 1, 7)
    assert (quantise_8_bit(values)[0, 0] * 255).round().tolist() == [0, 0, 0, 1, 128, 255, 255]


def test_an_affine_colour_change_is_taken_out() -> None:
    _, photo = images()
    mixing = torch.tensor([[0.7, 0.1, 0.0], [0.05, 0.8, -0.1], [0.0, 0.2, 0.6]])
    image = torch.einsum("ij,jhw->ihw", mixing, photo) + torch.tensor([0.1, 0.0, -0.05])[:, None, None]
    assert psnr(image, photo) < 25
    assert psnr_aligned(image, photo) > 100


@pytest.mark.parametrize("seed", range(5))
def test_aligning_never_loses(seed: int) -> None:
    image, photo = images(seed=seed)
    assert psnr_aligned(image, photo) >= psnr(image, photo) - 1e-9


@pytest.mark.parametrize(
    "image", [torch.zeros(3, 9, 9), torch.full((3, 9, 9), 0.3), torch.rand(1, 9, 9).expand(3, 9, 9)]
)
def test_images_of_few_colours_can_be_aligned(image: torch.Tensor) -> None:
    _, photo = images(9, 9)
    aligned = align_colours(image, photo)
    assert torch.isfinite(aligned).all()
    assert psnr(aligned, photo) >= psnr(image, photo) - 1e-6
    if image.std() == 0:
        torch.testing.assert_close(aligned, photo.mean((1, 2), keepdim=True).expand_as(photo))
