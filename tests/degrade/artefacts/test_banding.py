import torch

from gaussian_enhancer.degrade.artefacts.banding import banding
from gaussian_enhancer.degrade.artefacts.view import View
from support.generators import spawn_seeded


def test_the_foreground_stays_free_of_bands():
    image = torch.full((8, 3, 64, 64), 0.5)
    depth = torch.full((8, 1, 64, 64), 20.0)
    depth[..., 16:48, :24] = 2.0
    after = banding(View(image, depth), torch.ones(8), spawn_seeded(8))
    near = (depth < 10).expand_as(image)
    assert torch.equal(after.image[near], image[near])
    assert torch.equal(after.depth[..., 16:48, :24], depth[..., 16:48, :24])
    assert (after.image[~near] - 0.5).abs().mean() > 2e-3


def test_empty_sky_is_banded_and_receives_their_depth():
    image, depth = torch.full((4, 3, 64, 64), 0.5), torch.zeros(4, 1, 64, 64)
    depth[..., 40:, :] = 5.0
    after = banding(View(image, depth), torch.ones(4), spawn_seeded(4))
    hit = after.depth[..., :40, :] > 0
    assert hit.double().mean() > 0.1
    assert (after.depth[..., :40, :][hit] - 4.5).abs().max() < 0.5


def test_steps_on_a_plain_wall_can_be_seen_and_are_a_fraction_of_its_tone():
    image = torch.full((16, 3, 96, 96), 0.5)
    after = banding(View(image), torch.ones(16), spawn_seeded(16)).image
    deviation = (after / 0.5 - 1).abs().amax(dim=(1, 2, 3))
    assert deviation.min() > 0.03
    assert deviation.max() < 0.25


def test_bands_run_nearly_level():
    image = torch.full((16, 3, 96, 96), 0.5)
    after = banding(View(image), torch.ones(16), spawn_seeded(16, seed=1)).image
    down, right = after.diff(dim=2).square().mean(), after.diff(dim=3).square().mean()
    assert down > 3 * right


def test_rims_are_sharper_than_the_bands_are_wide():
    image = torch.full((8, 3, 128, 128), 0.5)
    after = banding(View(image), torch.ones(8), spawn_seeded(8)).image.double()
    steps = after.diff(dim=2).abs()
    # A smooth profile changes everywhere; flat tones change at rims only.
    assert (steps < 0.1 * steps.amax(dim=(1, 2, 3), keepdim=True)).double().mean() > 0.6


def test_bands_take_the_colour_of_what_they_cover_and_lose_its_texture():
    fine = torch.rand(8, 1, 64, 64, generator=torch.Generator().manual_seed(0)) - 0.5
    image = torch.tensor([0.3, 0.5, 0.4])[:, None, None] + 0.3 * fine
    after = banding(View(image), torch.ones(8), spawn_seeded(8)).image
    assert (after.mean(dim=(2, 3)) - image.mean(dim=(2, 3))).abs().max() < 0.03
    assert after.std(dim=(2, 3)).mean() < 0.95 * image.std(dim=(2, 3)).mean()
