import pytest
import torch
import torch.nn.functional as F

from gaussian_enhancer.degrade.generative.texture import OCTAVES, amplitudes, octaves, texture_difference


def noise(seed: int = 0, side: int = 64) -> torch.Tensor:
    return 0.5 + 0.1 * torch.randn(1, 3, side, side, generator=torch.Generator().manual_seed(seed))


def test_octaves_and_the_rest_are_the_image():
    image = noise()
    rest = image - sum(octaves(image))
    small = F.interpolate(F.avg_pool2d(image, 2**OCTAVES), scale_factor=2**OCTAVES, mode="bilinear")
    torch.testing.assert_close(rest, small)


def test_a_flat_image_has_no_detail():
    flat = torch.full((1, 3, 16, 24), 0.3)
    assert amplitudes(flat).max() < 0.004
    assert amplitudes(flat).shape == (1, 3 * (OCTAVES + 2), 2, 3)


def test_where_detail_lies_does_not_matter_and_how_strong_it_is_does():
    image = noise()
    elsewhere, weaker = texture_difference(noise(1), image), texture_difference(0.5 + 0.5 * (image - 0.5), image)
    assert texture_difference(image, image) == 0
    assert weaker > 3 * elsewhere
    # Pixel by pixel it is the other way round: a weak copy beats detail in other places.
    assert (noise(1) - image).abs().mean() > (0.5 * (image - 0.5)).abs().mean()


@pytest.mark.parametrize("axis", [2, 3])
def test_directions_are_told_apart(axis):
    stripes = noise().mean(axis, keepdim=True).expand_as(noise())
    turned = stripes.transpose(2, 3)
    assert texture_difference(stripes, turned) > 0.5 * (amplitudes(stripes) - amplitudes(0 * stripes)).abs().mean() / 3


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (17, 33)])
def test_any_size(size):
    image = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(0)).requires_grad_()
    texture_difference(image, torch.zeros_like(image)).backward()
    assert image.grad.isfinite().all()
