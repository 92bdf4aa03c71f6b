"""An earlier step's enhanced view is used where both differ and the references decide between them."""

import pytest
import torch
from torch import Tensor

from gaussian_enhancer.infer.earlier_step import DIFFERENCE, combine_with_earlier

GREY, OFFSET = 0.5, 0.2


def grey(value: float = GREY, side: int = 64) -> Tensor:
    return torch.full((3, side, side), value)


def share(enhanced: Tensor, earlier: Tensor, render: Tensor, earlier_render: Tensor) -> Tensor:
    """The share of the earlier view, where both views differ."""
    combined = combine_with_earlier(enhanced, earlier, render, earlier_render)
    return ((combined - enhanced) / (earlier - enhanced)).mean(0)


def test_the_render_that_photos_contradict_less_has_the_larger_share() -> None:
    enhanced, earlier = grey(0.45), grey(0.55)
    worse_last = share(enhanced, earlier, grey(0.2), grey(0.6))
    worse_earlier = share(enhanced, earlier, grey(0.4), grey(0.8))
    assert float(worse_last.min()) > 0.8 > 0.2 > float(worse_earlier.max())


def test_equal_errors_share_equally_where_the_views_differ_clearly() -> None:
    shares = share(grey(0.3), grey(0.7), grey(0.1), grey(0.9))
    difference = 0.4**2
    torch.testing.assert_close(shares, torch.full_like(shares, 0.5 * difference / (difference + DIFFERENCE**2)))


def test_slight_differences_leave_the_view_as_it_is() -> None:
    enhanced, earlier = grey(), grey(GREY + 0.004)
    shares = share(enhanced, earlier, grey(GREY - OFFSET), grey(GREY + OFFSET))
    assert 0 < float(shares.max()) < 0.01


@pytest.mark.parametrize(("remaining", "full"), [(1.0, 0.0), (0.8, 0.0), (0.65, 0.5), (0.5, 1.0), (0.2, 1.0)])
def test_without_evidence_the_view_stays_as_it_is(remaining, full) -> None:
    """``remaining`` of the renders' squared difference is left after enhancement."""
    half = OFFSET * remaining**0.5
    shares = share(grey(GREY - half), grey(GREY + half), grey(GREY - OFFSET), grey(GREY + OFFSET))
    difference = (2 * half) ** 2
    expected = full * 0.5 * difference / (difference + DIFFERENCE**2)
    torch.testing.assert_close(shares, torch.full_like(shares, expected), atol=2e-3, rtol=0)


def test_regions_are_decided_separately() -> None:
    """In the left half no photo decides, in the right half the last render was wrong."""
    enhanced, earlier, render, earlier_render = (grey(value, 128) for value in (0.4, 0.6, 0.4, 0.6))
    enhanced[..., 64:], earlier[..., 64:] = 0.55, 0.65
    render[..., 64:] = 0.2
    shares = share(enhanced, earlier, render, earlier_render)
    assert float(shares[:, :40].max()) < 1e-6
    assert float(shares[:, 90:].min()) > 0.6


def test_equal_steps_change_nothing() -> None:
    image = torch.rand(3, 40, 50, generator=torch.Generator().manual_seed(0))
    assert torch.equal(combine_with_earlier(image, image, image, image), image)


def test_small_views_are_combined() -> None:
    """Views that are smaller than the windows."""
    shares = share(grey(0.3, 5), grey(0.7, 5), grey(0.1, 5), grey(0.9, 5))
    assert float(shares.min()) > 0.4
