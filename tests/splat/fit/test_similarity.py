"""SSIM + L1: the compiled loss against its plain float64 twin, torchmetrics, and finite differences."""

import pytest
import torch
from torch.autograd import gradcheck
from torchmetrics.functional.image import structural_similarity_index_measure

from gaussian_enhancer.splat.fit.similarity import photometric_loss, prepare
from gaussian_enhancer.ssim import ssim_map


@pytest.fixture
def pair():
    generator = torch.Generator().manual_seed(3)
    photo = torch.rand(3, 23, 37, generator=generator)
    return (photo + 0.2 * torch.randn(3, 23, 37, generator=generator)), photo


@pytest.mark.parametrize("weight", [0.0, 0.2, 1.0])
def test_value_and_gradient_equal_the_float64_twin(pair, weight):
    image, photo = pair
    fast, exact = image.clone().requires_grad_(), image.double().requires_grad_()
    value = photometric_loss(fast, prepare(photo), weight)
    reference = photometric_loss(exact, prepare(photo.double()), weight)
    (3 * value).backward()
    (3 * reference).backward()
    torch.testing.assert_close(value.double(), reference, rtol=2e-5, atol=1e-6)
    torch.testing.assert_close(fast.grad.double(), exact.grad, rtol=2e-3, atol=2e-3 * exact.grad.abs().max().item())


def test_twin_passes_gradcheck():
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(1, 6, 5, generator=generator, dtype=torch.float64).requires_grad_()
    photo = torch.rand(1, 6, 5, generator=generator, dtype=torch.float64)
    assert gradcheck(lambda x: photometric_loss(x, prepare(photo), 0.7), (image,))


def test_interior_equals_torchmetrics(pair):
    # torchmetrics reflects at the borders and 3DGS pads with zeros: the inside does not know.
    image, photo = pair
    _, theirs = structural_similarity_index_measure(
        image.double()[None], photo.double()[None], data_range=1.0, return_full_image=True
    )
    ours = ssim_map(image.double(), photo.double())
    torch.testing.assert_close(ours[:, 5:-5, 5:-5], theirs[0][:, 5:-5, 5:-5], rtol=1e-5, atol=1e-6)


def test_equal_images_have_no_loss(pair):
    _, photo = pair
    assert photometric_loss(photo, prepare(photo)).item() == pytest.approx(0.0, abs=1e-6)


def test_prepared_statistics_equal_their_twin(pair):
    _, photo = pair
    fast, exact = prepare(photo), prepare(photo.double())
    torch.testing.assert_close(fast.mean.double(), exact.mean, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(fast.square.double(), exact.square, rtol=1e-5, atol=1e-6)


def test_one_pixel_wide_image_is_finite():
    image = torch.rand(3, 1, 1, generator=torch.Generator().manual_seed(0)).requires_grad_()
    photometric_loss(image, prepare(torch.zeros(3, 1, 1))).backward()
    assert image.grad.isfinite().all()
