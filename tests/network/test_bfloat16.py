"""Fused inference in bfloat16: as near to single precision as its readable twin, for every part of the networks."""

import dataclasses

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from gaussian_enhancer.network import bfloat16
from gaussian_enhancer.network.combine import Combination
from gaussian_enhancer.network.decode import Decoder
from gaussian_enhancer.network.deform import Unrefined
from gaussian_enhancer.network.depth_modulation import DepthModulated, DepthModulation
from gaussian_enhancer.network.fuse import Trust, TrustFusion
from gaussian_enhancer.network.halving import halve
from gaussian_enhancer.network.output_head import compose
from gaussian_enhancer.network.pyramid import average_views, upsample_bicubic
from gaussian_enhancer.network.ssif_sr import Tail, merge_torch
from gaussian_enhancer.network.stem import Gather
from gaussian_enhancer.types import NetworkInput

HEIGHT, WIDTH, CHANNELS = 24, 40, 16


def noise(*shape):
    return torch.rand(shape, generator=torch.Generator().manual_seed(len(shape) + sum(shape)))


def example(references=3, renders=True, depth=True):
    seen = noise(1, references, 1, HEIGHT, WIDTH)
    far = 1 + noise(1, 1, HEIGHT, WIDTH)
    far[..., :4, :6] = 0
    return NetworkInput(
        noise(1, 3, HEIGHT, WIDTH), noise(1, references, 3, HEIGHT, WIDTH), torch.where(seen < 0.3, 0.0, seen),
        far if depth else None, noise(1, 1, HEIGHT, WIDTH), torch.full((1,), 1.5),
        noise(1, references, 3, WIDTH, HEIGHT).transpose(-1, -2) if renders else None,
    )  # fmt: skip


def shaken(module):
    """The module with parameters of which none is zero."""
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape, generator=generator))
    return module.eval().to(memory_format=torch.channels_last)


def features(*shape):
    return (noise(*shape) - 0.5).to(memory_format=torch.channels_last)


def merge(views, seen, trust):
    """Images and trust of merged references; those of a view are at twice the resolution of what is seen of them."""
    found, together = merge_torch(views.render, views.references, halve(views.references), seen, trust)
    return found.references, found.visibility, found.reference_renders, together


def far_colours(views):
    """References and their renders far outside [0, 1], on either side."""
    photos, renders = (50 * (images - 0.5) for images in (views.references, views.reference_renders))
    return dataclasses.replace(views, references=photos, reference_renders=renders)


def part(name):
    """A call of a part: of the tensors that it takes, as it does within a network."""
    fusion, modulation = shaken(TrustFusion(CHANNELS)), shaken(DepthModulation(CHANNELS))
    pooled = shaken(TrustFusion(CHANNELS, pooled=True))
    decoder, combination = shaken(Decoder((16, 24), (1, 1), 6)), shaken(Combination(2, 8, CHANNELS))
    gather = shaken(Gather(CHANNELS, 1, Unrefined(), Trust(), DepthModulated(), True))
    views, half = example(), (HEIGHT // 2, WIDTH // 2)
    x, y = features(1, CHANNELS, *half), features(3, CHANNELS, *half)
    coarser = [noise(1, 11, *half) - 0.5, noise(1, 11, HEIGHT // 4, WIDTH // 4) - 0.5]
    decoded, trust = noise(1, 6, HEIGHT, WIDTH) - 0.5, noise(1, 3, 1, *half)
    seen = noise(1, 3, 1, *half)
    tail, grown, photo = shaken(Tail(12, 1, 6)), features(1, 48, HEIGHT // 4, WIDTH // 4), views.references[:, :1]
    without = NetworkInput(views.render, photo[:, :0], views.visibility[:, :0])
    calls = {
        "fuse": lambda t: fusion(t(x), t(y).unflatten(0, (1, 3)), seen),
        "fuse pooled": lambda t: pooled(t(x), t(y).unflatten(0, (1, 3)), seen),
        "modulate": lambda t: modulation(t(x), views.depth, views.depth_unit),
        "decode": lambda t: decoder(t(x)),
        "combine": lambda t: combination(views.render, views.references[:, 0], coarser),
        "gather": lambda t: gather(views),
        "gather without renders": lambda t: gather(example(renders=False)),
        "gather without depth": lambda t: gather(example(depth=False)),
        "gather far colours": lambda t: gather(far_colours(views)),
        "compose": lambda t: compose(t(decoded), views, trust),
        "compose without renders": lambda t: compose(t(decoded), example(renders=False), trust),
        "shrink": lambda t: average_views(views).references,
        "enlarge by 2": lambda t: upsample_bicubic(views.references[0], 2),
        "enlarge by 4": lambda t: upsample_bicubic(views.references[0], 4),
        "merge": lambda t: merge(views, seen, trust),
        "merge nearly nothing": lambda t: merge(views, torch.where(seen < 0.7, 0.0, seen), 1e-5 * trust),
        "tail": lambda t: tail(t(grown), NetworkInput(views.render, photo, views.visibility[:, :1]), trust[:, :1]),
        "tail without references": lambda t: tail(t(grown), without, trust[:, :1]),
    }
    return calls[name]


NAMES = [
    "fuse", "fuse pooled", "modulate", "decode", "combine", "gather", "gather without renders", "gather without depth",
    "gather far colours",
    "compose", "compose without renders", "shrink", "enlarge by 2", "enlarge by 4", "merge", "merge nearly nothing",
    "tail", "tail without references",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_a_fused_part_is_as_near_to_single_precision_as_its_twin(name) -> None:
    call = part(name)
    with torch.inference_mode():
        with FlopCounterMode(display=False):  # watches operations, which asks for the twin
            exact = flat(call(torch.Tensor.float))
        with torch.autocast("cpu", torch.bfloat16):
            fused = flat(call(torch.Tensor.bfloat16))
            with FlopCounterMode(display=False):
                plain = flat(call(torch.Tensor.bfloat16))
    scale = exact.square().mean().sqrt()
    assert (fused - exact).abs().max() < 0.05 * exact.abs().max()
    assert (fused - exact).square().mean().sqrt() < 1.2 * (plain - exact).square().mean().sqrt() + 1e-6 * scale


def flat(found):
    return torch.cat([one.float().flatten() for one in (found if isinstance(found, tuple) else (found,))])


@pytest.mark.parametrize("name", ["modulate", "combine"])
def test_two_images_are_fused_as_one_is(name) -> None:
    """Bit for bit: the same kernels and convolutions compute one image and two."""
    half, images = (HEIGHT // 2, WIDTH // 2), noise(2, 3, HEIGHT, WIDTH)
    if name == "modulate":
        module, depth = shaken(DepthModulation(CHANNELS)), 1 + noise(2, 1, HEIGHT, WIDTH)
        inputs = features(2, CHANNELS, *half).bfloat16(), depth, torch.tensor([1.5, 0.5])
    else:
        module = shaken(Combination(1, 8, CHANNELS))
        inputs = images, images.flip(-1), noise(2, 11, *half) - 0.5

    def call(*values):
        return module(*values) if name == "modulate" else module(*values[:2], values[2:])

    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16):
        both = call(*inputs)
        for i in range(2):
            assert torch.equal(call(*(values[i : i + 1] for values in inputs))[0], both[i])


def test_kernels_are_for_plain_images_without_a_gradient() -> None:
    image = torch.rand(1, 3, 4, 4)
    assert bfloat16.can_use_kernels(image, None)
    assert not bfloat16.can_use_kernels(image.double())
    assert not bfloat16.can_use_kernels(image, image.to("meta"))
    assert not bfloat16.can_use_kernels(image.clone().requires_grad_())
    with FlopCounterMode(display=False):
        assert not bfloat16.can_use_kernels(image)


def test_the_fused_ways_are_for_inference_in_bfloat16_alone() -> None:
    image = torch.rand(1, 3, 4, 4)
    assert not bfloat16.can_fuse(image)
    with torch.autocast("cpu", torch.bfloat16):
        assert not bfloat16.can_fuse(image)  # a gradient may be asked for
        with torch.inference_mode():
            assert bfloat16.can_fuse(image)
            assert not bfloat16.can_fuse(image.double())
            assert not bfloat16.can_fuse(image, image.to("meta"))
            with FlopCounterMode(display=False):
                assert not bfloat16.can_fuse(image)


def test_words_keep_bits() -> None:
    image = torch.randn(2, 8, 3, 5).bfloat16()
    words = bfloat16.kernel_words(image)
    assert words.shape == (2, 3, 5, 8)
    back = torch.from_numpy(words.view("int16")).view(torch.bfloat16).permute(0, 3, 1, 2)
    assert torch.equal(back, image)


def test_missing_references_fuse_nothing() -> None:
    views = example()
    none = dataclasses.replace(
        views, references=views.references[:, :0], visibility=views.visibility[:, :0], reference_renders=None
    )
    gather = shaken(Gather(CHANNELS, 1, Unrefined(), Trust(), DepthModulated(), True))
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16):
        assert gather(none)[1].shape[1] == 0
