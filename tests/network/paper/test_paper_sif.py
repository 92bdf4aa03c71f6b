"""Equations 3 and 4 of the paper: H = V(G[t-1], L, G[t+1]), E = S(H, D)."""

import dataclasses

import pytest
import torch

from gaussian_enhancer.network.paper.sif import PaperSIF
from support.networks import recorded, trained, visible_views


def small() -> PaperSIF:
    return PaperSIF(widths=(8, 16), blocks=(1, 1))


def test_view_fusion_comes_before_depth_modulation_with_an_image_between():
    network, seen = trained(small), visible_views()
    parts = {
        "Encoder(G)": network.encode_reference,
        "Encoder(L)": network.encode_target,
        "deform": network.fuse.align,
        "fuse": network.fuse,
        "H": network.decode,
        "Encoder(H)": network.encode_fused,
        "modulate by D": network.modulate,
        "E": network.decode_modulated,
    }
    with recorded(parts) as calls:
        fused, enhanced = network.stages(seen)
    features, image = (1, 8, 16, 32), (1, 3, 32, 64)
    assert [(name, given) for name, _, given in calls] == [
        ("Encoder(G)", (2, 8, 16, 32)),
        ("Encoder(L)", features),
        ("deform", (1, 2, 8, 16, 32)),
        ("fuse", features),
        ("H", image),
        ("Encoder(H)", features),
        ("modulate by D", features),
        ("E", image),
    ]
    assert fused.shape == enhanced.shape == image
    assert not torch.allclose(fused, enhanced, atol=1e-4)
    assert torch.equal(network(seen), enhanced)


def test_the_fused_view_knows_nothing_of_depth_and_the_result_does():
    network, seen = trained(small), visible_views()
    assert seen.depth is not None
    other = dataclasses.replace(seen, depth=seen.depth.flip(-1))
    (fused, enhanced), (fused_too, enhanced_too) = network.stages(seen), network.stages(other)
    assert torch.equal(fused, fused_too)
    assert (enhanced - enhanced_too).abs().max() > 1e-4


def test_modulation_reads_the_encoded_fused_view():
    network, seen = trained(small), visible_views()
    read: list[torch.Tensor] = []
    network.encode_fused.register_forward_pre_hook(lambda _, inputs: read.append(inputs[0]))
    fused, _ = network.stages(seen)
    torch.testing.assert_close(read[0] + 0.5, fused)


@pytest.mark.parametrize("changed", ["t-1", "t+1"])
def test_both_adjacent_views_reach_the_fused_view(changed):
    network, seen = trained(small), visible_views()
    references = seen.references.clone()
    references[:, ("t-1", "t+1").index(changed)] = 0.5
    other = network.stages(dataclasses.replace(seen, references=references))[0]
    assert (other - network.stages(seen)[0]).abs().max() > 1e-3
