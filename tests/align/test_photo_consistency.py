import pytest
import torch

from gaussian_enhancer.align.photo_consistency import (
    hide_inconsistent,
    photometric_difference,
    rank_references,
    reference_weight,
)
from gaussian_enhancer.align.reproject import Warped


def test_ranking_prefers_what_agrees_and_what_is_new():
    image = torch.full((3, 32, 32), 0.5)
    left, right = torch.zeros(1, 32, 32), torch.zeros(1, 32, 32)
    left[..., :20], right[..., 20:] = 1, 1
    good_left, good_right = Warped(image * left, left), Warped(image * right, right)
    wrong = Warped((image + 0.3) * left, left)
    everywhere = Warped((image + 0.3), torch.ones(1, 32, 32))
    wrong, everywhere, good_left, good_right = (
        reference_weight(one, photometric_difference(one, image)) for one in (wrong, everywhere, good_left, good_right)
    )
    assert rank_references([wrong, good_right, good_left], keep=2) == [2, 1]
    assert rank_references([everywhere, good_left, good_left, good_right], keep=2) == [1, 3]
    assert rank_references([], keep=2) == []


@pytest.mark.parametrize("size", [(1, 1), (5, 40), (48, 64)])
def test_compiled_disagreement_equals_its_readable_twin(size):
    colour, image, visibility = torch.rand(3, *size), torch.rand(3, *size), torch.rand(1, *size)
    visibility[..., : size[1] // 2] = 0
    found = photometric_difference(Warped(colour, visibility), image)
    truth = photometric_difference(Warped(colour.double(), visibility.double()), image.double())
    torch.testing.assert_close(found.double(), truth, rtol=1e-4, atol=1e-5)


PATCH = (slice(None), slice(8, 24), slice(8, 24))
INSIDE = (slice(None), slice(11, 21), slice(11, 21))
"""Pixels of the patch whose squares of 7x7 pixels lie within it."""


def seen(count: int) -> list[Warped]:
    """References of 32x32 pixels that show the render, which is grey."""
    return [Warped(torch.full((3, 32, 32), 0.5), torch.ones(1, 32, 32), torch.ones(3, 32, 32)) for _ in range(count)]


def hidden(references: list[Warped], image: torch.Tensor | None = None) -> list[torch.Tensor]:
    """Where each reference is hidden as an outlier; what is hidden has no colour either, the rest is unchanged."""
    image = torch.full((3, 32, 32), 0.5) if image is None else image
    found = hide_inconsistent(references, [photometric_difference(one, image) for one in references], 1.0)
    masks = [(before.visibility > 0) & (after.visibility == 0) for before, after in zip(references, found, strict=True)]
    for before, after, mask in zip(references, found, masks, strict=True):
        for name in ("colour", "visibility", "render"):
            assert torch.equal(getattr(after, name), getattr(before, name) * ~mask)
    return masks


@pytest.mark.parametrize("count", [2, 3, 5])
def test_what_one_reference_alone_shows_is_hidden_there(count):
    references = seen(count)
    references[1].colour[PATCH] += 0.2
    masks = hidden(references)
    assert bool(masks[1][INSIDE].all())
    assert not bool(masks[1][:, :5].any())
    assert not any(bool(mask.any()) for i, mask in enumerate(masks) if i != 1)


@pytest.mark.parametrize("offset", [0.0, 0.09, 0.14])
def test_small_differences_are_no_outliers(offset):
    references = seen(3)
    references[1].colour[PATCH] += offset
    assert not any(bool(mask.any()) for mask in hidden(references))


def test_a_reference_that_no_other_reference_shows_is_kept():
    references = seen(3)
    references[1].colour[PATCH] += 0.2
    for i in (0, 2):
        references[i].visibility[PATCH] = 0
    assert not any(bool(mask[PATCH].any()) for mask in hidden(references))


def test_references_that_contradict_the_render_together_are_kept():
    """The splat may be wrong there."""
    references = seen(3)
    for reference in references:
        reference.colour[PATCH] += 0.2
    assert not any(bool(mask.any()) for mask in hidden(references))


def test_a_reference_is_kept_where_the_other_is_as_far_from_the_render():
    references = seen(2)
    references[0].colour[PATCH] -= 0.15
    references[1].colour[PATCH] += 0.2
    assert not any(bool(mask.any()) for mask in hidden(references))


def test_a_reference_that_the_limit_hides_does_not_testify_against_another():
    references = seen(2)
    references[0].colour[PATCH] += 0.18
    near, far = torch.full((1, 32, 32), 0.05), torch.full((1, 32, 32), 0.18)
    heard = hide_inconsistent(references, [far, near], 0.2)
    assert not bool(heard[0].visibility[INSIDE].any())
    references[1].visibility[:] = 0
    assert bool(hide_inconsistent(references, [far, near], 0.2)[0].visibility.all())
    witness_hidden = hide_inconsistent([*seen(1), references[0]], [torch.full((1, 32, 32), 0.3), far], 0.2)
    assert not bool(witness_hidden[0].visibility.any())
    assert bool(witness_hidden[1].visibility.all())
