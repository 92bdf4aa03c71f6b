import dataclasses

import pytest
import torch

from gaussian_enhancer.align.depth_normalisation import depth_unit, normalised_inverse_depth
from gaussian_enhancer.network.deform import Deformable, Unrefined
from gaussian_enhancer.network.depth_modulation import DepthModulated, Unmodulated
from gaussian_enhancer.network.fuse import Mean, Trust
from support.networks import small_sif, trained, views


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (24, 40), (41, 17)])
@pytest.mark.parametrize("references", [0, 1, 3])
@pytest.mark.parametrize("refine", [Unrefined(), Deformable()])
def test_untrained_network_returns_the_render_bit_for_bit(size, references, refine):
    seen = views(*size, references=references)
    assert torch.equal(small_sif(refine=refine)(seen), seen.render)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(small_sif(refine=refine)(seen), seen.render)


@pytest.mark.parametrize("refine", [Unrefined(), Deformable(), Deformable(kernel=1)])
@pytest.mark.parametrize("fusion", [Trust(), Trust(pooled=True), Mean()])
def test_order_of_references_changes_nothing(refine, fusion):
    network, seen = trained(refine=refine, fusion=fusion), views(references=3)
    order = torch.tensor([2, 0, 1])
    mixed = dataclasses.replace(seen, references=seen.references[:, order], visibility=seen.visibility[:, order])
    torch.testing.assert_close(network(mixed), network(seen), rtol=0, atol=1e-5)
    assert not torch.allclose(network(seen), seen.render, atol=1e-3)


def test_pooling_adds_nothing_at_birth_and_tells_references_of_each_other_later():
    plain, pooled, seen = trained(), small_sif(fusion=Trust(pooled=True)), views(references=3)
    missing, odd = pooled.load_state_dict(plain.state_dict(), strict=False)
    assert missing == ["gather.fuse.pool.weight"]
    assert not odd
    torch.testing.assert_close(pooled(seen), plain(seen), rtol=0, atol=1e-6)
    torch.nn.init.normal_(pooled.gather.fuse.pool.weight)
    assert not torch.allclose(pooled(seen), plain(seen), atol=1e-3)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf"), 1e-30, 1e30])
def test_extreme_depth_stays_finite(value):
    seen = views()
    assert seen.depth is not None
    depth = seen.depth.clone()
    depth[..., :12, :] = value
    network = trained()
    assert bool(torch.isfinite(network(dataclasses.replace(seen, depth=depth))).all())
    everywhere = torch.full_like(depth, value)
    assert bool(torch.isfinite(network(dataclasses.replace(seen, depth=everywhere))).all())


def test_absent_depth_equals_no_modulation():
    network, seen = trained(), views()
    absent = dataclasses.replace(seen, depth=None)
    torch.testing.assert_close(network(absent), network(dataclasses.replace(seen, depth=torch.zeros(1, 1, 24, 40))))
    network.gather.modulate = Unmodulated().build(16)
    torch.testing.assert_close(network(absent), network(seen))


def test_inverse_depth_is_relative_to_the_unit():
    depth = torch.tensor([[[[1.0, 2.0, 4.0, 0.0]]]])
    unit = depth_unit(depth)
    assert float(unit) == 2.0
    torch.testing.assert_close(normalised_inverse_depth(depth, unit), torch.tensor([[[[2.0, 1.0, 0.5, 0.0]]]]))
    assert DepthModulated().build(8)(torch.ones(1, 8, 1, 2), torch.rand(1, 1, 2, 4), None).shape == (1, 8, 1, 2)
