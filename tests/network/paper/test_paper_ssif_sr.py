"""Algorithm 2 of the paper, line by line."""

import dataclasses
from collections import Counter

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from gaussian_enhancer.network.paper.ssif_sr import PaperSSIFSR
from support.networks import recorded, trained, visible_views


def small(buffer: bool = True) -> PaperSSIFSR:
    return PaperSSIFSR(widths=(8, 16), blocks=(1, 1), buffer=buffer)


def named(network: PaperSSIFSR) -> dict[str, nn.Module]:
    """Every step of the algorithm by its name there."""
    parts: dict[str, nn.Module] = {
        "Encoder(G)": network.encode_reference,
        "Encoder(L)": network.encode_target,
        "Encoder(D)": network.encode_depth,
        "DeformableConv": network.fuse,
        "Combine 2": network.combine[0],
        "Combine 4": network.combine[1],
    }
    for level, scale in enumerate((1, 2, 4)):
        parts |= {
            f"Encoder(HG) {scale}": network.encode_fine[level],
            f"(+) {scale}": network.join[level],
            f"Decoder {scale}": network.decode[level],
        }
    return parts


def seen_by(**choices) -> tuple[PaperSSIFSR, list]:
    network = trained(small, **choices)
    with recorded(named(network)) as calls:
        network(visible_views(16, 32, fine=True))
    return network, calls


def test_reads_come_in_the_order_of_the_algorithm():
    _, calls = seen_by()
    assert [name for name, _, _ in calls] == [
        "Encoder(G)",
        "Encoder(HG) 1",
        "Encoder(HG) 2",
        "Encoder(HG) 4",
        "Encoder(L)",
        "DeformableConv",
        "Encoder(D)",
        *("(+) 1", "Decoder 1"),
        *("(+) 2", "Decoder 2", "Combine 2"),
        *("(+) 4", "Decoder 4", "Combine 4"),
    ]


def test_shapes_are_those_of_each_scale():
    _, calls = seen_by()
    found = {name: (read, given) for name, read, given in calls}
    low = (1, 8, 8, 16)
    assert found["Encoder(G)"] == (((2, 3, 16, 32),), (2, 8, 8, 16))
    assert found["Encoder(L)"] == (((1, 3, 16, 32),), low)
    assert found["Encoder(D)"] == (((1, 2, 16, 32),), low)
    assert found["DeformableConv"][1] == low
    for scale in (1, 2, 4):
        features, image = (1, 8, 8 * scale, 16 * scale), (1, 3, 16 * scale, 32 * scale)
        assert found[f"Encoder(HG) {scale}"] == (((2, *image[1:]),), (2, *features[1:]))
        assert found[f"(+) {scale}"] == ((features,) * 4, features)
        assert found[f"Decoder {scale}"] == ((features,), image)
    one, two, four = ((1, 3, 16 * scale, 32 * scale) for scale in (1, 2, 4))
    assert found["Combine 2"] == ((two, one), two)
    assert found["Combine 4"] == ((four, one, two), four)


def test_what_is_cached_is_what_finer_scales_read():
    network = trained(small)
    fused: list[torch.Tensor] = []
    depth: list[torch.Tensor] = []
    joined: list[tuple[torch.Tensor, ...]] = []
    network.fuse.register_forward_hook(lambda _, inputs, output: fused.append(output))
    network.encode_depth.register_forward_hook(lambda _, inputs, output: depth.append(output))
    for join in network.join:
        join.register_forward_pre_hook(lambda _, inputs: joined.append(inputs))
    network(visible_views(16, 32, fine=True))
    assert len(fused) == len(depth) == 1
    assert joined[0][0] is fused[0]
    assert joined[0][1] is depth[0]
    for scale, (fused_there, depth_there, *_) in zip((2, 4), joined[1:], strict=True):
        torch.testing.assert_close(fused_there, F.interpolate(fused[0], scale_factor=scale, mode="bilinear"))
        torch.testing.assert_close(depth_there, F.interpolate(depth[0], scale_factor=scale, mode="bilinear"))


def test_without_the_buffer_each_scale_computes_anew_what_it_reads_and_the_image_is_the_same():
    _, cached = seen_by()
    network, computed = seen_by(buffer=False)
    counts = Counter(name for name, _, _ in computed)
    names = ("Encoder(L)", "Encoder(D)", "DeformableConv")
    assert {name: counts[name] for name in names} == dict.fromkeys(names, 3)
    assert counts["Encoder(G)"] == counts["Encoder(HG) 4"] == 1
    assert Counter(name for name, _, _ in cached)["DeformableConv"] == 1
    seen = visible_views(16, 32, fine=True)
    again = trained(small)
    again.load_state_dict(network.state_dict())
    assert torch.equal(network(seen), again(seen))


def test_references_are_downsampled_by_4_and_2_and_kept():
    network = trained(small)
    read: dict[int, torch.Tensor] = {}
    for scale, encoder in zip((1, 2, 4), network.encode_fine, strict=True):
        encoder.register_forward_pre_hook(lambda _, inputs, scale=scale: read.update({scale: inputs[0] + 0.5}))
    seen = visible_views(16, 32, fine=True)
    network(seen)
    assert seen.fine_references is not None
    photos = seen.fine_references[0]
    torch.testing.assert_close(read[4], photos)
    torch.testing.assert_close(read[2], F.avg_pool2d(photos, 2))
    torch.testing.assert_close(read[1], F.avg_pool2d(photos, 4))


@pytest.mark.parametrize("scale", [1, 2, 4])
def test_fine_references_reach_every_scale(scale):
    network, seen = trained(small), visible_views(16, 32, fine=True)
    assert seen.fine_references is not None
    other = dataclasses.replace(seen, fine_references=seen.fine_references.flip(-1))
    level = (1, 2, 4).index(scale)
    assert (network.stages(seen)[level] - network.stages(other)[level]).abs().max() > 1e-4


def test_coarser_results_reach_the_finer_ones_and_not_the_other_way():
    network, seen = trained(small), visible_views(16, 32, fine=True)
    before = network.stages(seen)
    network.decode[2].head.bias.data += 0.1
    assert [torch.equal(a, b) for a, b in zip(before, network.stages(seen), strict=True)] == [True, True, False]
    network.decode[0].head.bias.data += 0.1
    assert not any(torch.equal(a, b) for a, b in zip(before, network.stages(seen), strict=True))


def test_scales_share_no_weights():
    network = small()
    for parts in (network.encode_fine, network.join, network.decode):
        one, two, four = ({id(parameter) for parameter in part.parameters()} for part in parts)
        assert not one & two
        assert not two & four
        assert not one & four
