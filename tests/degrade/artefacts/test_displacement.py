import pytest
import torch

from gaussian_enhancer.degrade.artefacts.displacement import displace, displacement, random_offset
from gaussian_enhancer.degrade.artefacts.view import View
from support.generators import spawn_seeded


@pytest.mark.parametrize("mode", ["bilinear", "nearest"])
def test_whole_offsets_read_whole_pixels_and_the_border_goes_on(mode):
    planes = torch.rand(1, 2, 6, 9, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    offset = torch.zeros(1, 2, 6, 9, dtype=torch.float64)
    offset[:, 0], offset[:, 1] = 2, -1
    y, x = torch.meshgrid(torch.arange(6) - 1, torch.arange(9) + 2, indexing="ij")
    torch.testing.assert_close(displace(planes, offset, mode), planes[..., y.clamp(0, 5), x.clamp(0, 8)])


def test_fractions_are_interpolated():
    ramp = torch.arange(9.0).expand(1, 1, 6, 9)
    offset = torch.full((1, 2, 6, 9), 0.25)
    torch.testing.assert_close(displace(ramp, offset)[..., :8], ramp[..., :8] + 0.25)


def test_offsets_are_as_long_and_jumps_as_many_as_they_say():
    like = torch.zeros(8, 3, 192, 192)
    full = random_offset(torch.ones(8), spawn_seeded(8), like)
    half = random_offset(torch.full((8,), 0.5), spawn_seeded(8), like)
    # The smooth part doubles with the strength, a jump is as long at any.
    jumped = ((full - 2 * half).abs() > 0.5).any(dim=1, keepdim=True)
    assert 0.02 < jumped.double().mean() < 0.03
    smooth = full[(~jumped).expand_as(full)]
    assert 0.8 < smooth.std() < 1.3
    assert (smooth.abs() > 3.5).double().mean() < 0.01


def test_image_depth_and_opacity_move_together():
    depth = torch.rand(2, 1, 40, 48, generator=torch.Generator().manual_seed(0)) + 1
    depth[:, :, 10:20] = 0
    alpha = (depth > 0).float()
    image = alpha.expand(-1, 3, -1, -1).clone()
    after = displacement(View(image, depth, alpha), torch.ones(2), spawn_seeded(2))
    torch.testing.assert_close(after.image[:, :1], after.alpha)
    assert torch.isin(after.depth, depth).all()
    assert (after.depth != depth).float().mean() > 0.3
    sure = (after.alpha < 0.01) | (after.alpha > 0.99)
    assert torch.equal((after.depth > 0)[sure], (after.alpha > 0.5)[sure])


def test_gradcheck():
    image = torch.rand(1, 3, 4, 5, generator=torch.Generator().manual_seed(0)).double().requires_grad_()
    strength = torch.full((1,), 0.5, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: displacement(View(x), strength, spawn_seeded(1)).image, (image,))
