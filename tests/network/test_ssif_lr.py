import dataclasses
import json

import pytest
import torch
import torch.nn.functional as F

from gaussian_enhancer.infer.weights import build_design, count_parameters, design_of
from gaussian_enhancer.network.combine import Combined, Uncombined
from gaussian_enhancer.network.deform import Deformable
from gaussian_enhancer.network.fuse import Trust
from gaussian_enhancer.network.output_head import Residual
from gaussian_enhancer.network.pyramid import average_views, pad_to_stride
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.network.ssif_lr import SSIFLR
from support.networks import trained, views


def small(**choices) -> SSIFLR:
    return SSIFLR(widths=(16, 16, 24), blocks=(1, 1, 1), **choices)


def test_untrained_every_scale_returns_its_render():
    seen = views(height=40, width=25)
    scales = small(refine=Deformable()).stages(seen)
    assert [tuple(image.shape[-2:]) for image in scales] == [(10, 7), (20, 13), (40, 25)]
    assert torch.equal(scales[-1], seen.render)
    whole = pad_to_stride(seen, 16).render
    torch.testing.assert_close(scales[0], F.avg_pool2d(whole, 4)[..., :10, :7])
    torch.testing.assert_close(scales[1], F.avg_pool2d(whole, 2)[..., :20, :13])


@pytest.mark.parametrize("share", [True, False])
def test_known_features_give_the_same(share):
    network, seen = trained(small, share=share), views()
    assert torch.equal(network(seen, network.encode(seen)), network(seen))


def test_finest_scale_alone_is_sif():
    """With scales that know nothing of each other, the last one is SIF with the same weights."""
    network, seen = trained(small, combine=Uncombined(), fusion=Trust()), views(height=32, width=48)
    sif = SIF(widths=(16, 16, 24), blocks=(1, 1, 1))
    sif.gather.load_state_dict(network.gather[0].state_dict())
    sif.decode.load_state_dict(network.decode[2].state_dict())
    torch.testing.assert_close(network(seen), sif.eval()(seen), rtol=0, atol=1e-6)


def test_coarser_scales_change_finer_ones_and_not_the_other_way():
    network, seen = trained(small), views()
    before = network.stages(seen)
    network.decode[2].head.bias.data += 0.1
    after = network.stages(seen)
    assert [torch.equal(a, b) for a, b in zip(before, after, strict=True)] == [True, True, False]
    network.settle.head.bias.data += 0.1
    assert not any(torch.equal(a, b) for a, b in zip(after, network.stages(seen), strict=True))


def test_coarsest_scale_is_aligned_to_its_own_first_result():
    """E(1/4) gathers with T in place of the render: zero what settles, and E is T."""
    network, seen = trained(small), views()
    for parameter in network.settle.parameters():
        torch.nn.init.zeros_(parameter)
    coarse = average_views(average_views(pad_to_stride(seen, 16)))
    gather = network.gather[0]
    first = network.output(network.decode[0](gather(coarse)[0]), coarse, gather(coarse)[1])
    torch.testing.assert_close(network.stages(seen)[0], first[..., :6, :10])
    calls = []
    gather.encode_render.register_forward_pre_hook(lambda module, inputs: calls.append(inputs[0]))
    network(seen)
    torch.testing.assert_close(calls[1], first)


def test_sees_further_than_its_finest_scale_alone():
    """A change 40 pixels away reaches a pixel through the coarse scales."""
    seen = views(height=16, width=128, references=0)
    other = seen.render.clone()
    other[..., 104:] += 0.3
    changed = dataclasses.replace(seen, render=other)
    reach = {}
    for combine in (Combined(), Uncombined()):
        network = trained(small, combine=combine)
        difference = (network(changed) - network(seen)).abs().amax((0, 1, 2))
        reach[type(combine)] = 104 - int(torch.nonzero(difference > 0)[0])
    assert reach[Combined] > reach[Uncombined] + 16


@pytest.mark.parametrize("choices", [{}, {"share": False}, {"combine": Uncombined(), "output": Residual()}])
def test_design_rebuilds_the_same_network(choices):
    network = trained(small, **choices)
    again = build_design(json.loads(json.dumps(design_of(network)))).eval()
    again.load_state_dict(network.state_dict())
    assert torch.equal(again(views()), network(views()))


def test_costs_at_most_as_much_more_than_sif_as_its_scales_are_worth():
    assert count_parameters(SSIFLR()) < 1.8 * count_parameters(SIF())
    assert count_parameters(SSIFLR()) < count_parameters(SSIFLR(share=False))
