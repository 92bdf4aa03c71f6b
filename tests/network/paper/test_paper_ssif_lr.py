"""Algorithm 3 of the paper, line by line."""

import dataclasses

import torch
from torch import nn

from gaussian_enhancer.network.paper.ssif_lr import PaperSSIFLR
from gaussian_enhancer.network.paper.stages import LearnedCombine
from gaussian_enhancer.network.pyramid import average_views, pad_to_stride, upsample_bicubic
from support.networks import recorded, trained, visible_views


def small() -> PaperSSIFLR:
    return PaperSSIFLR(widths=(8, 16), blocks=(1, 1))


def named(network: PaperSSIFLR) -> dict[str, nn.Module]:
    """Every step of the algorithm by its name there."""
    parts: dict[str, nn.Module] = {}
    for scale, factor in zip(network.scales, ("1/4", "1/2", "1"), strict=True):
        parts |= {
            f"Encoder(G) {factor}": scale.encode_reference,
            f"Encoder(L) {factor}": scale.encode_target,
            f"Encoder(D) {factor}": scale.encode_depth,
            f"DeformableConv {factor}": scale.fuse,
            f"(+) {factor}": scale.join_depth,
            f"Decoder {factor}": scale.decode,
        }
    return parts | {
        "DeformableConv(temp_E) 1/4": network.align_again,
        "Combine 1/2": network.combine,
        "Fuse 1": network.fuse,
    }


def test_reads_come_in_the_order_of_the_algorithm():
    network, seen = trained(small), visible_views()
    with recorded(named(network)) as calls:
        images = network.stages(seen)

    def scale(factor: str) -> list[str]:
        return [f"{name} {factor}" for name in ("Encoder(L)", "Encoder(D)", "DeformableConv", "(+)", "Decoder")]

    assert [name for name, _, _ in calls] == [
        *(f"Encoder(G) {factor}" for factor in ("1/4", "1/2", "1")),
        *scale("1/4"),
        "DeformableConv(temp_E) 1/4",
        *scale("1/2"),
        "Combine 1/2",
        *scale("1"),
        "Fuse 1",
    ]
    assert [tuple(image.shape) for image in images] == [(1, 3, 8, 16), (1, 3, 16, 32), (1, 3, 32, 64)]


def test_shapes_are_those_of_each_scale():
    network, seen = trained(small), visible_views()
    with recorded(named(network)) as calls:
        network(seen)
    found = {name: (read, given) for name, read, given in calls}
    for factor, (height, width) in {"1/4": (8, 16), "1/2": (16, 32), "1": (32, 64)}.items():
        features = (1, 8, height // 2, width // 2)
        assert found[f"Encoder(G) {factor}"] == (((2, 3, height, width),), (2, *features[1:]))
        assert found[f"Encoder(L) {factor}"] == (((1, 3, height, width),), features)
        assert found[f"Encoder(D) {factor}"] == (((1, 2, height, width),), features)
        assert found[f"DeformableConv {factor}"][1] == features
        assert found[f"(+) {factor}"] == ((features, features), features)
        assert found[f"Decoder {factor}"] == ((features,), (1, 3, height, width))
    assert found["Combine 1/2"] == (((1, 3, 16, 32), (1, 3, 8, 16)), (1, 3, 16, 32))
    assert found["Fuse 1"] == (((1, 3, 32, 64), (1, 3, 8, 16), (1, 3, 16, 32)), (1, 3, 32, 64))


def test_references_are_aligned_again_to_the_decoded_quarter():
    """E(1/4) = DeformableConv(temp_E(1/4), F[G t-1](1/4), F[G t+1](1/4))."""
    network, seen = trained(small), visible_views()
    read: dict[str, torch.Tensor] = {}
    network.encode_coarsest.register_forward_pre_hook(lambda _, inputs: read.update(image=inputs[0]))
    network.align_again.register_forward_pre_hook(lambda _, inputs: read.update(references=inputs[1]))
    network(seen)
    coarse = average_views(average_views(pad_to_stride(seen, network.stride)))
    first = network.scales[0](coarse, network.encode(seen)[0])
    torch.testing.assert_close(read["image"] + 0.5, first)
    torch.testing.assert_close(read["references"], network.encode(seen)[0])


def test_no_scale_shares_weights_with_another():
    scales = [{id(parameter) for parameter in scale.parameters()} for scale in small().scales]
    assert all(scales)
    assert not scales[0] & scales[1]
    assert not scales[1] & scales[2]
    assert not scales[0] & scales[2]


def test_coarser_results_reach_the_finer_ones_and_not_the_other_way():
    network, seen = trained(small), visible_views()
    before = network.stages(seen)
    network.fuse.head.bias.data += 0.1
    assert [torch.equal(a, b) for a, b in zip(before, network.stages(seen), strict=True)] == [True, True, False]
    network.align_again.join.bias.data += 0.1
    assert not any(torch.equal(a, b) for a, b in zip(before, network.stages(seen), strict=True))


def test_combine_can_pass_a_coarser_image_on():
    """Combine is learned over images: it can become the enlarged coarser image alone."""
    combine = LearnedCombine(1, 48)
    for layer in (combine.join, combine.head):
        nn.init.zeros_(layer.weight)
        nn.init.zeros_(layer.bias)
    for plane in range(24):  # the image's planes, positive and negative parts, since relu stands between
        combine.join.weight.data[plane, plane, 1, 1] = 1
        combine.join.weight.data[24 + plane, plane, 1, 1] = -1
    for plane in range(12):
        for sign, start in ((1, 0), (-1, 24)):
            combine.head.weight.data[plane, start + 12 + plane, 1, 1] = sign
            combine.head.weight.data[plane, start + plane, 1, 1] = -sign
    fine, coarse = torch.rand(1, 3, 16, 16), torch.rand(1, 3, 8, 8)
    torch.testing.assert_close(combine(fine, coarse), upsample_bicubic(coarse, 2), rtol=0, atol=1e-5)


def test_depth_reaches_every_scale():
    network, seen = trained(small), visible_views()
    assert seen.depth is not None
    other = dataclasses.replace(seen, depth=seen.depth.flip(-1))
    for one, two in zip(network.stages(seen), network.stages(other), strict=True):
        assert (one - two).abs().max() > 1e-4
