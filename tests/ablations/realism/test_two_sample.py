import dataclasses

import numpy as np
import pytest
import torch

from ablations.realism.patches import Patches
from ablations.realism.two_sample import Classifier, area_under_curve, two_sample_test, view_interval
from gaussian_enhancer.errors import InputError


def patches(scenes, seed, change=None, places=12, views=4, size=16):
    """Independent noise of one distribution on both sides, the simulated side changed."""
    generator = torch.Generator().manual_seed(seed)
    n = len(scenes) * views * places
    simulated, real, photo = (100 + 30 * torch.randn(n, 3, size, size, generator=generator) for _ in range(3))
    simulated = simulated if change is None else change(simulated)
    names = tuple((scene, str(view)) for scene in scenes for view in range(views))
    view = torch.arange(len(names)).repeat_interleave(places)
    images = (image.clamp(0, 255).round().to(torch.uint8) for image in (simulated, real, photo))
    return Patches(*images, view, names)


def smoothed(images):
    return torch.nn.functional.avg_pool2d(images, 3, 1, 1, count_include_pad=False) + 10


TRAIN, TEST = ("a", "b", "c", "d", "e"), ("f", "g", "h")


def test_cannot_tell_renders_of_one_distribution():
    found = two_sample_test(patches(TRAIN, 0), patches(TEST, 1), seeds=2, epochs=3)
    assert found.low <= 0.5 <= found.high
    assert found.high - found.low < 0.3
    assert abs(found.auc - 0.5) < 0.1
    assert (found.n, found.views, found.seeds) == (2 * 3 * 4 * 12, 12, 2)


@pytest.mark.parametrize("conditional", [False, True])
def test_tells_plainly_different_renders(conditional):
    train, test = patches(TRAIN, 0, smoothed), patches(TEST, 1, smoothed)
    found = two_sample_test(train, test, conditional=conditional, seeds=1, epochs=6)
    assert found.accuracy > 0.95
    assert found.low <= found.accuracy <= found.high
    assert found.auc > 0.99
    assert found.deviation is None


def test_is_at_chance_when_labels_are_drawn_by_lot():
    def by_lot(one, seed):
        swapped = torch.rand(len(one), generator=torch.Generator().manual_seed(seed)) < 0.5
        swapped = swapped[:, None, None, None]
        simulated, real = torch.where(swapped, one.real, one.simulated), torch.where(swapped, one.simulated, one.real)
        return dataclasses.replace(one, simulated=simulated, real=real)

    train, test = (by_lot(patches(s, i, smoothed, views=8), i) for i, s in enumerate((TRAIN, TEST)))
    found = two_sample_test(train, test, seeds=1, epochs=3)
    # three standard deviations of 576 coins, of which neighbours may be told alike
    assert abs(found.accuracy - 0.5) < 0.08


def test_is_determined_by_its_seed_and_leaves_global_chance_alone():
    train, test = patches(TRAIN, 0), patches(TEST, 1)
    state = torch.random.get_rng_state()
    first, again = (two_sample_test(train, test, seeds=1, epochs=1, first_seed=5) for _ in range(2))
    assert first == again
    assert torch.equal(state, torch.random.get_rng_state())
    assert two_sample_test(train, test, seeds=1, epochs=1, first_seed=6).auc != first.auc


def test_refuses_a_scene_on_both_sides_and_a_single_view():
    with pytest.raises(InputError, match="training scene and a test scene"):
        two_sample_test(patches(("a", "b"), 0), patches(("b", "c"), 1))
    with pytest.raises(InputError, match="single view"):
        two_sample_test(patches(("a",), 0, views=1), patches(("b",), 1))


def test_interval_resamples_views_not_patches():
    view = torch.arange(20).repeat_interleave(50)
    by_view = (view % 2).float()
    low, high = view_interval(by_view, view)
    # the mean of 20 coins has a standard error of 0.115, and t of 19 degrees of freedom is 2.09; of 1000 coins, 0.016
    assert low == pytest.approx(0.5 - 2.09 * 0.115, abs=0.03)
    assert high == pytest.approx(0.5 + 2.09 * 0.115, abs=0.03)
    constant = view_interval(torch.full((1000,), 0.75), view)
    assert constant == pytest.approx((0.75, 0.75))


@pytest.mark.parametrize("views", [8, 10, 20])
def test_intervals_hold_the_truth_as_often_as_they_say(views):
    """Coverage by simulation: the accuracy of a view differs from the mean accuracy, and views differ in patches."""
    generator, held, trials, truth = np.random.default_rng(4), 0, 600, 0.6
    for _ in range(trials):
        places = generator.integers(12, 37, views)
        view = np.repeat(np.arange(views), places)
        accuracy = generator.beta(6, 4, views)  # of mean 0.6
        correct = generator.uniform(size=len(view)) < accuracy[view]
        low, high = view_interval(torch.from_numpy(correct).float(), torch.from_numpy(view))
        held += low <= truth <= high
    assert 0.92 <= held / trials <= 0.98  # without the correction 0.88 of 8 views and 0.89 of 10


@pytest.mark.filterwarnings("error")
def test_two_views_have_an_interval_between_them():
    assert view_interval(torch.tensor([1.0, 1.0, 0.0, 0.0]), torch.tensor([0, 0, 1, 1])) == (0.0, 1.0)


def test_area_under_curve_counts_pairs():
    generator = torch.Generator().manual_seed(0)
    positive, negative = (torch.randint(0, 6, (n,), generator=generator).float() for n in (40, 40))
    difference = positive[:, None] - negative[None, :]
    counted = ((difference > 0).float() + 0.5 * (difference == 0).float()).mean().item()
    assert area_under_curve(positive, negative) == pytest.approx(counted)
    assert area_under_curve(torch.arange(5.0) + 5, torch.arange(5.0)) == 1


def test_classifier_is_small_and_undecided_at_birth():
    network = Classifier(6, torch.Generator().manual_seed(0))
    assert 30_000 < sum(p.numel() for p in network.parameters()) < 60_000
    assert network(torch.rand(4, 6, 32, 32)).abs().max() == 0
