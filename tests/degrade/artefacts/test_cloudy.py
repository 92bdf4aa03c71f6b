import torch

from gaussian_enhancer.degrade.artefacts.cloudy import cloudy
from gaussian_enhancer.degrade.artefacts.view import View
from support.generators import spawn_seeded


def textured(count=8, size=64):
    image = torch.rand(count, 3, size, size, generator=torch.Generator().manual_seed(3))
    return View(image, torch.full((count, 1, size, size), 4.0), torch.ones(count, 1, size, size))


def test_a_veil_has_no_detail_of_its_own():
    black = View(torch.zeros(8, 3, 64, 64))
    veil = cloudy(black, torch.ones(8), spawn_seeded(8)).image
    assert veil.mean() > 0.05
    assert veil.diff(dim=2).abs().max() < 0.02
    assert veil.diff(dim=3).abs().max() < 0.02


def test_it_lowers_contrast_and_keeps_some():
    view = textured()
    after = cloudy(view, torch.ones(8), spawn_seeded(8)).image
    share = after.std(dim=(1, 2, 3)) / view.image.std(dim=(1, 2, 3))
    assert share.max() < 0.98
    assert share.min() > 0.2


def test_veils_bring_the_depth_nearer_as_much_as_they_hide():
    view = textured()
    after = cloudy(view, torch.ones(8), spawn_seeded(8))
    black = cloudy(
        View(torch.zeros_like(view.image), view.depth, torch.zeros_like(view.alpha)), torch.ones(8), spawn_seeded(8)
    )
    hidden = black.alpha
    # Veils hang between 0.2 and 0.7 of the median depth.
    assert (after.depth <= 4 - 4 * 0.3 * hidden + 1e-3).all()
    assert (after.depth >= 4 - 4 * 0.8 * hidden - 1e-3).all()
    assert hidden.mean() > 0.05


def test_veils_do_not_hang_behind_the_surfaces_before_them():
    view = textured()
    depth = view.depth.clone()
    depth[..., :16, :16] = 0.4
    after = cloudy(View(view.image, depth), torch.ones(8), spawn_seeded(8))
    assert torch.equal(after.image[..., :16, :16], view.image[..., :16, :16])
