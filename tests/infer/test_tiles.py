import dataclasses

import pytest
import torch

from gaussian_enhancer.align.depth_normalisation import depth_unit
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.tiles import enhance_tiled
from gaussian_enhancer.network.deform import Deformable
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.network.ssif_sr import SSIFSR
from gaussian_enhancer.types import NetworkInput
from support.networks import trained, views


def large(height: int, width: int) -> NetworkInput:
    seen = views(height, width)
    assert seen.depth is not None
    return NetworkInput(seen.render, seen.references, seen.visibility, seen.depth, seen.alpha, depth_unit(seen.depth))


@pytest.mark.parametrize("size", [(352, 200), (390, 413)])
def test_tiles_equal_the_whole_where_the_halo_covers_the_reach(size):
    network, seen = trained(), large(*size)
    with torch.no_grad():
        tiled, whole = enhance_tiled(network, seen, tile=288, halo=96, blend=16), network(seen)
    torch.testing.assert_close(tiled, whole, rtol=0, atol=2e-4)


def test_no_seam_with_a_small_halo():
    network, seen = trained(refine=Deformable(kernel=1)), large(200, 200)
    with torch.no_grad():
        error = (enhance_tiled(network, seen, tile=128, halo=32, blend=32) - network(seen)).abs()
    assert error.max() < 0.02


def test_identity_of_any_size_is_kept():
    seen = large(150, 97)
    tiled = enhance_tiled(lambda v: v.render, seen, tile=64, halo=16, blend=16)
    torch.testing.assert_close(tiled, seen.render)


@pytest.mark.parametrize("sides", [{"tile": 100}, {"tile": 64, "halo": 32}, {"halo": 20}])
def test_impossible_tiles_are_refused(sides):
    with pytest.raises(InputError, match="tile"):
        enhance_tiled(lambda v: v.render, large(200, 200), **sides)


def test_tiles_of_a_network_that_enlarges():
    seen = large(150, 97)
    sides = {"tile": 64, "halo": 16, "blend": 16, "scale": 4}
    tiled = enhance_tiled(lambda v: upsample_bicubic(v.render, 4), seen, **sides)
    torch.testing.assert_close(tiled, upsample_bicubic(seen.render, 4))
    fine = dataclasses.replace(seen, fine_references=torch.rand(1, 2, 3, 600, 388))
    shown = enhance_tiled(lambda v: v.fine_references[:, 1], fine, **sides)
    torch.testing.assert_close(shown, fine.fine_references[:, 1])


def test_no_seam_in_a_super_resolved_image():
    network = SSIFSR((8, 8, 8), (1, 1, 1)).eval()
    torch.manual_seed(1)
    for parameter in network.parameters():
        parameter.data += 0.05 * torch.randn_like(parameter)
    seen = dataclasses.replace(large(136, 144), fine_references=torch.rand(1, 2, 3, 544, 576))
    with torch.no_grad():
        whole = network(seen)
        error = (enhance_tiled(network, seen, tile=128, halo=48, blend=16, scale=4) - whole).abs()
    assert error.max() < 0.01
    assert (whole - upsample_bicubic(seen.render, 4)).abs().max() > 0.1
