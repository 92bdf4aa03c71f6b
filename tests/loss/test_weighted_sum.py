import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.loss.terms import (
    DSSIM,
    Charbonnier,
    FrequencyDifference,
    GradientDifference,
    Harm,
    Relative,
    SquaredError,
    dssim,
)
from gaussian_enhancer.loss.weighted_sum import Weighted, WeightedLoss

TERMS = [
    Charbonnier(),
    DSSIM(),
    FrequencyDifference(),
    GradientDifference(),
    Harm(),
    SquaredError(),
    Relative(Charbonnier(), 0.01),
]


@pytest.fixture
def images() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    enhanced, photo, render = torch.rand(3, 2, 3, 20, 24, generator=generator, dtype=torch.float64)
    return enhanced, photo, render


@pytest.mark.parametrize("term", TERMS)
def test_is_unreduced_zero_at_the_photo_and_has_finite_gradients(term, images):
    enhanced, photo, render = images
    assert term(enhanced, photo, render).shape == photo.shape
    assert term(photo, photo, render).abs().max() < 2e-4
    at_photo = photo.clone().requires_grad_()
    term(at_photo, photo, render).sum().backward()
    assert bool(torch.isfinite(at_photo.grad).all())


@pytest.mark.parametrize("term", [Charbonnier(0.1), DSSIM()])
def test_gradient(term):
    generator = torch.Generator().manual_seed(0)
    enhanced, photo = torch.rand(2, 1, 1, 6, 6, generator=generator, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: term(x, photo, photo), enhanced.requires_grad_())


def test_known_values():
    zero, one = torch.zeros(1, 1, 16, 16), torch.ones(1, 1, 16, 16)
    torch.testing.assert_close(Charbonnier()(one, zero, zero).mean(), torch.tensor(0.999), rtol=0, atol=1e-5)
    middle = dssim(one, zero)[0, 0, 8, 8]
    torch.testing.assert_close(middle, torch.tensor(1 - 1e-4 / (1 + 1e-4)), rtol=0, atol=1e-4)
    spectrum = FrequencyDifference()(one, zero, zero)
    assert spectrum.argmax() == 0
    torch.testing.assert_close(spectrum.max(), torch.tensor(16.0))


def test_ssim_equals_torchmetrics(images):
    functional = pytest.importorskip("torchmetrics.functional.image")
    enhanced, photo, _ = (image.float() for image in images)
    photo = 0.7 * enhanced + 0.3 * photo
    _, theirs = functional.structural_similarity_index_measure(enhanced, photo, data_range=1.0, return_full_image=True)
    inner = (..., slice(5, -5), slice(5, -5))
    torch.testing.assert_close(1 - dssim(enhanced, photo)[inner], theirs[inner], rtol=0, atol=1e-4)


def test_harm_is_counted_only_where_it_became_worse():
    photo, render = torch.zeros(1, 3, 32, 32), torch.full((1, 3, 32, 32), 0.2)
    enhanced = torch.full_like(photo, 0.1)
    enhanced[..., 16:] = 0.5
    cost = Harm()(enhanced, photo, render)
    assert cost[..., :12].max() == 0
    torch.testing.assert_close(cost[..., 20:], torch.full_like(cost[..., 20:], 0.3))


def test_relative_weighs_good_and_bad_renders_alike():
    photo = torch.zeros(2, 3, 8, 8)
    render = torch.cat([torch.full((1, 3, 8, 8), 0.5), torch.full((1, 3, 8, 8), 0.01)])
    cost = Relative(SquaredError(), 1e-12)(0.5 * render, photo, render)
    torch.testing.assert_close(cost, torch.full_like(cost, 0.25), rtol=1e-4, atol=0)
    unchanged = Relative(SquaredError(), 1e-12)(render, photo, render)
    torch.testing.assert_close(unchanged.mean(), torch.tensor(1.0), rtol=1e-4, atol=0)


def test_relative_harm_is_in_units_of_the_renders_error_and_none_where_nothing_was_harmed():
    photo, render = torch.zeros(1, 3, 16, 16), torch.full((1, 3, 16, 16), 0.1)
    cost = Relative(Harm(), 1e-12, unit=Charbonnier(1e-6))
    torch.testing.assert_close(cost(2 * render, photo, render), torch.ones_like(render), rtol=1e-3, atol=0)
    assert cost(0.5 * render, photo, render).max() == 0


def test_total_is_the_weighted_sum(images):
    enhanced, photo, render = images
    loss = WeightedLoss({"a": Weighted(Charbonnier(), 2.0), "b": Weighted(DSSIM(), 0.5), "c": None})
    total, parts = loss(enhanced, photo, render)
    torch.testing.assert_close(total, 2 * parts["a"] + 0.5 * parts["b"])
    assert set(parts) == {"a", "b"}


@pytest.mark.parametrize("terms", [{}, {"a": None}, {"a": Weighted(Charbonnier(), -1.0)}])
def test_useless_losses_are_refused(terms):
    with pytest.raises(InputError, match="loss"):
        WeightedLoss(terms)
