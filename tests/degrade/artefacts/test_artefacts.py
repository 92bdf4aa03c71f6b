"""What every artefact keeps to; its own tests say what it does."""

from itertools import pairwise

import pytest
import torch

from gaussian_enhancer.degrade.artefact_types import ARTEFACTS
from gaussian_enhancer.degrade.artefacts.view import View
from support.generators import spawn_seeded

pytestmark = pytest.mark.parametrize("artefact", ARTEFACTS.values(), ids=ARTEFACTS.keys())


def photos(count=4, height=48, width=40, dtype=torch.float32):
    """Shaded surfaces with texture, edges between them and depth to match, in [0, 1]."""
    generator = torch.Generator().manual_seed(1)
    y = torch.linspace(0, 1, height)[:, None]
    x = torch.linspace(0, 1, width)[None, :]
    turn, place, shade = torch.rand(3, count, 3, 1, 1, generator=generator)
    waves = torch.sin(40 * (x * turn + y * (1 - turn)) + 6 * place)
    inside = ((x - place[:, :1]).abs() < 0.3) & ((y - turn[:, :1]).abs() < 0.3)
    image = 0.15 + 0.5 * shade * (0.5 + 0.5 * x) + 0.1 * waves + 0.2 * inside
    depth = torch.where(inside, 2.0, 3.0 + y)
    depth[:, :, :3] = 0
    alpha = torch.where(depth > 0, 0.9 + 0.1 * x, 0.0)
    return View(image.clamp(0, 1).to(dtype), depth.to(dtype), alpha.to(dtype))


def strengths(view, value):
    return torch.full((len(view),), value, dtype=view.image.dtype)


def assert_same(view, other, **tolerance):
    for name in ("image", "depth", "alpha"):
        torch.testing.assert_close(getattr(view, name), getattr(other, name), **tolerance)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_strength_0_changes_nothing(artefact, dtype):
    view = photos(dtype=dtype)
    after = artefact(view, strengths(view, 0.0), spawn_seeded(4))
    for name in ("image", "depth", "alpha"):
        assert torch.equal(getattr(after, name), getattr(view, name)), name


def test_the_change_grows_with_the_strength(artefact):
    view = photos()
    changes = [
        sum(
            float((artefact(view, strengths(view, s), spawn_seeded(4, seed)).image - view.image).abs().mean())
            for seed in range(6)
        )
        for s in (0, 0.25, 0.5, 0.75, 1)
    ]
    assert all(less < more for less, more in pairwise(changes)), changes


def test_a_little_strength_changes_little(artefact):
    view = photos()
    full = (artefact(view, strengths(view, 1.0), spawn_seeded(4)).image - view.image).abs().mean()
    slight = (artefact(view, strengths(view, 1e-3), spawn_seeded(4)).image - view.image).abs().mean()
    assert slight < 0.05 * full


def test_equal_generators_give_equal_results_and_others_do_not(artefact):
    view = photos()
    first, again, other = (artefact(view, strengths(view, 0.7), spawn_seeded(4, seed)) for seed in (3, 3, 4))
    assert_same(first, again, rtol=0, atol=0)
    if artefact is not ARTEFACTS.get("jpeg"):
        assert not torch.equal(first.image, other.image)


def test_a_batch_is_its_samples_one_by_one(artefact):
    view = photos()
    strength = torch.tensor([0.2, 1.0, 0.5, 0.0])
    together = artefact(view, strength, spawn_seeded(4))
    for i, generator in enumerate(spawn_seeded(4)):
        index = torch.tensor([i])
        assert_same(artefact(view[index], strength[index], [generator]), together[index], rtol=0, atol=2e-5)


def test_single_precision_is_as_good_as_double(artefact):
    view = photos(dtype=torch.float64)
    single = View(view.image.float(), view.depth.float(), view.alpha.float())
    exact = artefact(view, strengths(view, 0.5), spawn_seeded(4)).image
    difference = (artefact(single, strengths(single, 0.5), spawn_seeded(4)).image.double() - exact).abs()
    # Where something is rounded, a few pixels may fall on the other side.
    assert (difference > 1e-4).double().mean() < 0.01
    assert difference.median() < 1e-5


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (17, 33)])
@pytest.mark.parametrize("level", [0.0, 0.5, 1.0, None])
def test_any_size_and_constant_images_stay_finite_and_in_range(artefact, size, level):
    image = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(0))
    if level is not None:
        image = torch.full_like(image, level)
    depth = torch.full_like(image[:, :1], 2.0)
    for s in (1e-3, 1.0):
        after = artefact(View(image, depth, torch.ones_like(depth)), torch.full((2,), s), spawn_seeded(2))
        assert after.image.shape == image.shape
        assert torch.isfinite(after.image).all()
        assert after.image.min() >= -1e-5
        assert after.image.max() <= 1 + 1e-5
        assert (after.depth >= 0).all()
        assert ((after.alpha >= 0) & (after.alpha <= 1 + 1e-6)).all()


def test_inputs_are_not_written_into(artefact):
    view, kept = photos(), photos()
    strength = strengths(view, 0.8)
    artefact(view, strength, spawn_seeded(4))
    assert_same(view, kept, rtol=0, atol=0)
    assert torch.equal(strength, strengths(view, 0.8))


def test_absent_depth_and_opacity_stay_absent(artefact):
    view = photos()
    bare = artefact(View(view.image), strengths(view, 0.8), spawn_seeded(4))
    assert bare.depth is None
    assert bare.alpha is None


def test_gradients_reach_the_image_and_are_finite(artefact):
    image = photos(dtype=torch.float64).image
    image[:, :, :4, :4] = torch.tensor([0.0, 1.0, 0.0, 1.0], dtype=torch.float64)
    image.requires_grad_()
    artefact(View(image), torch.full((4,), 0.6, dtype=torch.float64), spawn_seeded(4)).image.square().sum().backward()
    assert torch.isfinite(image.grad).all()
    assert (image.grad != 0).double().mean() > 0.3
