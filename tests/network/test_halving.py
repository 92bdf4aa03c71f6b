"""Halving: torch's own pixel-unshuffle bit for bit, the mean of squares, gradients, programs without word tricks."""

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st

from gaussian_enhancer.network.halving import halve, pixel_unshuffle

SIDES = st.integers(1, 5).map(lambda side: 2 * side)


@settings(deadline=None, max_examples=40)
@given(
    st.integers(1, 3), st.integers(1, 9), SIDES, SIDES,
    st.sampled_from([torch.bfloat16, torch.float16, torch.float32, torch.float64]),
)  # fmt: skip
def test_unshuffling_is_torchs_bit_for_bit(batch, channels, height, width, dtype) -> None:
    image = torch.randn(batch, channels, height, width).to(dtype)
    found = pixel_unshuffle(image)
    assert torch.equal(found, F.pixel_unshuffle(image, 2))
    if dtype is not torch.float64:
        assert found.is_contiguous(memory_format=torch.channels_last)


def test_no_image_stays_none() -> None:
    assert pixel_unshuffle(torch.zeros(0, 3, 4, 6)).shape == (0, 12, 2, 3)  # torch's own returns what it is given


def test_images_that_lie_in_memory_otherwise_are_unshuffled_alike() -> None:
    whole = torch.randn(2, 6, 9, 12)
    cut = whole[:, 1:4, 1:7, 3:9]
    for image in (cut, cut.contiguous(memory_format=torch.channels_last), cut.transpose(2, 3)):
        assert torch.equal(pixel_unshuffle(image), F.pixel_unshuffle(image, 2))


def test_bits_that_are_no_number_pass() -> None:
    image = torch.full((1, 1, 2, 2), torch.nan)
    image[..., 0, 0] = torch.inf
    assert torch.equal(pixel_unshuffle(image).isnan(), F.pixel_unshuffle(image, 2).isnan())


@pytest.mark.parametrize("function", [pixel_unshuffle, halve])
def test_gradients_pass(function) -> None:
    image = torch.randn(1, 2, 4, 6, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(function, (image,))
    single = torch.randn(1, 2, 4, 6, requires_grad=True)
    function(single).square().sum().backward()
    assert single.grad is not None


def test_an_exported_program_holds_no_words() -> None:
    class Unshuffling(torch.nn.Module):
        def forward(self, image: torch.Tensor) -> torch.Tensor:
            return pixel_unshuffle(image)

    program = torch.export.export(Unshuffling(), (torch.randn(1, 2, 4, 6),))
    assert not any("view.dtype" in str(node.target) for node in program.graph.nodes)


@pytest.mark.parametrize("shape", [(4, 6), (3, 4, 6), (2, 0, 3, 4, 6), (2, 3, 1, 8, 2)])
def test_halving_is_the_mean_of_squares(shape) -> None:
    image = torch.rand(shape)
    *before, height, width = shape
    expected = image.view(*before, height // 2, 2, width // 2, 2).mean((-3, -1))
    found = halve(image)
    assert found.shape == expected.shape
    assert torch.allclose(found, expected, atol=1e-6)
    assert torch.equal(halve(torch.ones_like(image)), torch.ones_like(expected))
