import torch

from gaussian_enhancer.degrade.artefacts.floater import FLOATERS, floater
from gaussian_enhancer.degrade.artefacts.view import View
from support.generators import spawn_seeded


def wall(count=16, size=64, depth=5.0):
    shape = (count, 1, size, size)
    return View(torch.full((count, 3, size, size), 0.5), torch.full(shape, depth), torch.ones(shape))


def test_depth_drops_to_the_floaters_where_they_are_seen():
    view = wall()
    after = floater(view, torch.ones(16), spawn_seeded(16))
    clear = View(view.image, view.depth, torch.zeros_like(view.alpha))
    covered = floater(clear, torch.ones(16), spawn_seeded(16)).alpha
    # With weight W at 0.1 to 0.4 of the depth, expected depth is 1 - W (1 - 0.1 ... 0.4) of it.
    share = after.depth / view.depth
    assert (share >= 1 - 0.9 * covered - 1e-4).all()
    assert (share <= 1 - 0.6 * covered + 1e-4).all()
    assert covered.amax(dim=(1, 2, 3)).max() > 0.6
    assert torch.equal(after.depth[covered == 0], view.depth[covered == 0])


def test_depth_follows_the_scale_of_the_scene():
    small, large = (floater(wall(depth=d), torch.ones(16), spawn_seeded(16)).depth / d for d in (0.01, 300.0))
    torch.testing.assert_close(small, large, rtol=1e-4, atol=1e-4)


def test_floaters_are_compact():
    transparent = View(torch.zeros(32, 3, 64, 64), alpha=torch.zeros(32, 1, 64, 64))
    alpha = floater(transparent, torch.ones(32), spawn_seeded(32)).alpha
    assert (alpha > 0.05).double().mean() < 0.4
    assert (alpha.amax(dim=(1, 2, 3)) > 0.12).all()
    assert (alpha == 0).double().mean() > 0.2


def test_every_number_of_floaters_occurs(monkeypatch):
    kept = []
    monkeypatch.setattr(
        "gaussian_enhancer.degrade.artefacts.floater.composite", lambda view, splats: kept.append(splats) or view
    )
    floater(wall(count=200, size=4), torch.ones(200), spawn_seeded(200))
    numbers = (kept[0].opacity > 0).sum(1)
    assert set(numbers.tolist()) == set(range(1, FLOATERS + 1))
    assert kept[0].opacity.max() <= 0.9


def test_colours_come_from_the_image_or_are_dark_or_bright(monkeypatch):
    kept = []
    monkeypatch.setattr(
        "gaussian_enhancer.degrade.artefacts.floater.composite", lambda view, splats: kept.append(splats) or view
    )
    floater(wall(count=100, size=4), torch.ones(100), spawn_seeded(100))
    tone = kept[0].colour.mean(2)
    borrowed, dark, bright = tone == 0.5, tone <= 0.15, tone >= 0.8
    assert (borrowed | dark | bright).all()
    assert 0.7 < borrowed.double().mean() < 0.9
    assert dark.any()
    assert bright.any()
