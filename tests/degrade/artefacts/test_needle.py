import math

import pytest
import torch

from gaussian_enhancer.degrade.artefacts import needle as module
from gaussian_enhancer.degrade.artefacts.needle import needle
from gaussian_enhancer.degrade.artefacts.view import View
from support.generators import spawn_seeded


@pytest.fixture
def drawn(monkeypatch):
    """What needle hands to the compositor."""
    kept = []
    monkeypatch.setattr(module, "composite", lambda view, splats: kept.append(splats) or view)

    def draw(view, strength=1.0, seed=0):
        generators = spawn_seeded(len(view), seed)
        needle(view, torch.full((len(view),), strength), generators)
        return kept[-1]

    return draw


def ramp(count=4, size=64):
    x = torch.linspace(0.2, 0.6, size).expand(count, 3, size, size).contiguous()
    return View(x, 2 + x[:, :1])


def test_needles_are_thin(drawn):
    length, thickness = drawn(ramp(count=8, size=256)).log_sigma.exp().unbind(2)
    assert length.min() >= 256 * module.LENGTHS[0] * 0.999
    assert length.max() <= 256 * module.LENGTHS[1]
    assert (length / thickness).median() > module.RATIOS[0]
    assert (length / thickness).max() <= module.RATIOS[1] * 1.001
    assert thickness.min() >= module.MIN_SIGMA * 0.999


def test_the_number_follows_the_area_up_to_a_limit(drawn):
    counts = [drawn(ramp(count=1, size=size)).depth.shape[1] for size in (4, 64, 128, 400)]
    assert counts == [1, 64**2 // module.AREA, 128**2 // module.AREA, module.MAX_NEEDLES]


def test_strength_scales_opacity_and_nothing_else(drawn):
    half, full = drawn(ramp(), 0.5), drawn(ramp(), 1.0)
    torch.testing.assert_close(2 * half.opacity, full.opacity)
    for name in ("centre", "log_sigma", "angle", "colour", "depth"):
        assert torch.equal(getattr(half, name), getattr(full, name))
    assert full.opacity[full.opacity > 0].min() > 0.4
    assert full.opacity.max() < 1


def test_needles_lie_a_little_in_front_of_their_surface(drawn):
    view = ramp()
    splats = drawn(view)
    x, y = splats.centre.floor().long().clamp(0, 63).unbind(2)
    surface = torch.stack([view.depth[b, 0, y[b], x[b]] for b in range(4)])
    share = splats.depth / surface
    assert share.min() >= 0.88
    assert share.max() <= 0.99


def test_colours_are_those_of_the_image_a_little_off(drawn):
    blue = torch.tensor([0.2, 0.3, 0.6])[:, None, None].expand(4, 3, 128, 128)
    colour = drawn(View(blue.contiguous())).colour
    assert (colour.flatten(0, 1).median(0).values - blue[0, :, 0, 0]).abs().max() < 0.08
    assert (colour.argmax(2) == 2).double().mean() > 0.95
    assert colour.std() > 0.03


def test_most_of_them_crowd_in_place_and_direction(drawn):
    splats = drawn(ramp(count=16, size=256))
    turns = splats.angle
    alignment = torch.stack([(2 * turns).cos().mean(1), (2 * turns).sin().mean(1)]).norm(dim=0)
    # Uniform directions alone would reach 1 / sqrt(160) or so.
    assert alignment.mean() > 2 / math.sqrt(module.MAX_NEEDLES)
    middle = splats.centre.median(dim=1, keepdim=True).values
    near = (splats.centre - middle).norm(dim=2) < 0.3 * 256
    assert near.double().mean() > 0.5  # a uniform scatter has 0.28 there


def test_a_crowd_has_two_directions_that_cross(drawn):
    turns = drawn(ramp(count=16, size=256)).angle
    crowd = turns.gather(1, (turns - turns.median(dim=1, keepdim=True).values).abs().argsort(dim=1)[:, :40])
    aside = ((turns - crowd.mean(1, keepdim=True)).abs() > 0.2 * math.pi).double().mean(1)
    assert aside.mean() > 0.3


def test_a_full_crowd_hides_what_lies_behind():
    view = View(torch.full((8, 3, 256, 256), 0.5))
    after = needle(view, torch.ones(8), spawn_seeded(8, seed=3))
    changed = ((after.image - 0.5).abs().amax(1) > 0.03).double()
    dense = torch.nn.functional.avg_pool2d(changed[:, None], 64, 8).flatten(1).amax(1)
    assert dense.mean() > 0.5


def test_changed_pixels_form_thin_lines():
    view = View(torch.full((1, 3, 128, 128), 0.5))
    after = needle(view, torch.ones(1), spawn_seeded(1, seed=2))
    changed = ((after.image - view.image).abs().amax(1) > 0.02)[0].double()
    share = changed.mean()
    assert 0.005 < share < 0.4
    eroded = -torch.nn.functional.max_pool2d(-changed[None, None], 9, 1, 4)
    assert eroded.mean() < 0.1 * share
