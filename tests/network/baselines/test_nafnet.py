import dataclasses

import pytest
import torch

from gaussian_enhancer.infer.weights import count_parameters
from gaussian_enhancer.network.baselines.nafnet import LocalAttention, NAFBlock, NAFNet, PixelNorm
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.types import NetworkInput
from support.networks import views


def trained(network: NAFNet) -> NAFNet:
    """The network with its zero-initialised layer moved."""
    generator = torch.Generator().manual_seed(1)
    for parameter in network.parameters():
        parameter.data += 0.05 * torch.randn(parameter.shape, generator=generator)
    return network.eval()


def small() -> NAFNet:
    torch.manual_seed(0)
    return NAFNet(widths=(8, 12, 16), blocks=(1, 1, 1), encoder_blocks=0)


@pytest.mark.parametrize(
    ("widths", "blocks", "encoder_blocks"),
    [((16, 24, 32), (1, 1, 2), 1), ((32, 64, 96), (2, 2, 3), 1), ((48, 96, 144), (3, 3, 6), 2)],
)
def test_has_as_many_parameters_as_sif(widths, blocks, encoder_blocks):
    sizes = [count_parameters(kind(widths, blocks, encoder_blocks)) for kind in (NAFNet, SIF)]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.05)


def test_sees_render_and_opacity_alone():
    network, seen = trained(small()), views(references=3)
    result = network(seen)
    other = views(references=5, seed=1)
    changed = dataclasses.replace(other, render=seen.render, alpha=seen.alpha, depth=None)
    assert torch.equal(network(changed), result)
    assert not torch.allclose(network(dataclasses.replace(seen, alpha=None)), result, atol=1e-4)
    assert not torch.allclose(result, seen.render, atol=1e-3)


def test_interior_of_a_crop_equals_the_whole():
    torch.manual_seed(0)
    network = trained(NAFNet(widths=(8, 8), blocks=(1, 1), encoder_blocks=0))
    whole = views(height=32, width=32 * 20)
    crop = whole.map_images(lambda image, finer: image[..., 32 * 2 : 32 * 17])
    # Six blocks, each of which sees its cell, the next one and a pixel more: 32 * 7 pixels are enough.
    inner = network(crop)[..., 32 * 7 : 32 * 8]
    torch.testing.assert_close(inner, network(whole)[..., 32 * 9 : 32 * 10], rtol=0, atol=1e-6)
    shifted = whole.map_images(lambda image, finer: image[..., 32 * 2 + 8 : 32 * 17 + 8])
    assert not torch.allclose(network(shifted)[..., 32 * 7 - 8 : 32 * 8 - 8], inner, rtol=0, atol=1e-6)


def test_norm_is_over_the_channels_of_a_pixel():
    norm, x = PixelNorm(6), torch.randn(2, 6, 5, 4)
    centred = x - x.mean(1, keepdim=True)
    expected = centred / torch.sqrt(centred.square().mean(1, keepdim=True) + 1e-5)
    torch.testing.assert_close(norm(x), expected)
    last = x.contiguous(memory_format=torch.channels_last)
    assert norm(last).is_contiguous(memory_format=torch.channels_last)


def test_attention_weighs_by_the_mean_of_a_square():
    attention = LocalAttention(2, cell=4)
    torch.nn.init.dirac_(attention.weigh.weight)
    torch.nn.init.zeros_(attention.weigh.bias)
    torch.testing.assert_close(attention(torch.full((1, 2, 8, 8), 3.0)), torch.full((1, 2, 8, 8), 9.0))
    x = torch.randn(1, 2, 4, 4)
    torch.testing.assert_close(attention(x), x * x.mean((2, 3), keepdim=True))


def test_block_equals_its_formula():
    torch.manual_seed(0)
    block, x = NAFBlock(4, cell=4), torch.randn(1, 4, 8, 8)
    first, second = block.depthwise(block.widen(block.first_norm(x))).split(4, dim=1)
    y = x + 0.2 * block.project(block.attend(first * second))
    third, fourth = block.expand(block.second_norm(y)).split(4, dim=1)
    torch.testing.assert_close(block(x), y + 0.2 * block.contract(third * fourth))


def test_refuses_a_window_that_its_levels_cannot_halve():
    with pytest.raises(ValueError, match="no multiple of 8"):
        NAFNet(window=20)


def test_takes_a_batch_without_references():
    seen = views(references=0, batch=2)
    network = trained(small())
    both = network(seen)
    alone = network(NetworkInput(seen.render[1:], seen.references[1:], seen.visibility[1:], None, seen.alpha[1:]))  # type: ignore[index]
    torch.testing.assert_close(both[1:], alone)
