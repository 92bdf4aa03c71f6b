import pytest
import torch

from gaussian_enhancer.degrade import manual
from gaussian_enhancer.degrade.artefacts.region import soft_region
from gaussian_enhancer.degrade.artefacts.rng import named_generator
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.gate import ArtefactStep
from gaussian_enhancer.degrade.manual import degrade
from support.generators import spawn_seeded


def halve(view, strength, generators):
    return View(view.image * (1 - strength[:, None, None, None] / 2), view.depth, view.alpha)


def square(view, strength, generators):
    return View(view.image**2, view.depth, view.alpha)


def whiten(view, strength, generators):
    return View(torch.ones_like(view.image), view.depth, view.alpha)


@pytest.fixture
def stand_ins(monkeypatch):
    monkeypatch.setattr(manual, "ARTEFACTS", {"blur": halve, "noise": square, "colour": whiten})


def photo(count=1, size=(24, 32)):
    return View(torch.rand(count, 3, *size, generator=torch.Generator().manual_seed(0)))


def test_what_is_drawn_for_a_step_does_not_depend_on_the_steps_before_it(monkeypatch):
    def speckled(view, strength, generators):
        drawn = torch.stack([torch.rand(3, *view.image.shape[-2:], generator=one) for one in generators])
        return View(view.image + drawn, view.depth, view.alpha)

    def same(view, strength, generators):
        torch.rand(5, generator=generators[0])
        return view

    monkeypatch.setattr(manual, "ARTEFACTS", {"blur": same, "noise": speckled})
    alone = degrade(photo(), [(ArtefactStep("noise", 1.0),)], spawn_seeded(1, seed=1)).image
    after = degrade(photo(), [(ArtefactStep("blur", 1.0), ArtefactStep("noise", 1.0))], spawn_seeded(1, seed=1)).image
    assert torch.equal(alone, after)
    other = degrade(photo(), [(ArtefactStep("noise", 1.0),)], spawn_seeded(1, seed=2)).image
    assert not torch.equal(alone, other)


@pytest.mark.usefixtures("stand_ins")
def test_each_sample_gets_its_own_steps_in_its_own_order_and_none_if_it_has_none():
    view, first, second = photo(4), ArtefactStep("blur", 1.0), ArtefactStep("noise", 0.5)
    done = degrade(view, [(first, second), (second, first), (), (second,)], spawn_seeded(4, seed=1)).image
    torch.testing.assert_close(done[0], (view.image[0] / 2) ** 2)
    torch.testing.assert_close(done[1], view.image[1] ** 2 / 2)
    assert torch.equal(done[2], view.image[2])
    torch.testing.assert_close(done[3], view.image[3] ** 2)


@pytest.mark.usefixtures("stand_ins")
def test_strengths_stay_with_their_samples():
    view = photo(2)
    done = degrade(view, [(ArtefactStep("blur", 0.2),), (ArtefactStep("blur", 0.8),)], spawn_seeded(2, seed=1)).image
    torch.testing.assert_close(done, view.image * torch.tensor([0.9, 0.6])[:, None, None, None])


@pytest.mark.usefixtures("stand_ins")
@pytest.mark.parametrize("seed", range(5))
def test_a_regional_step_acts_by_the_share_of_its_region(seed):
    view = View(torch.zeros(1, 3, 64, 96))
    done = degrade(view, [(ArtefactStep("colour", 1.0, regional=True),)], spawn_seeded(1, seed)).image
    own = named_generator("colour", int(torch.randint(2**62, (), generator=spawn_seeded(1, seed)[0])))
    region = soft_region(64, 96, [own], view.image)
    torch.testing.assert_close(done, region.expand_as(done))
    assert region.min() < 0.5 < 0.95 < region.max() <= 1


@pytest.mark.usefixtures("stand_ins")
def test_a_type_without_a_function_is_an_error_and_no_silent_pass():
    with pytest.raises(KeyError):
        degrade(photo(), [(ArtefactStep("needle", 0.5),)], spawn_seeded(1, seed=1))
