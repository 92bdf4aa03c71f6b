import pytest
import torch

from gaussian_enhancer.align.photo_consistency import photometric_difference, rank_references, reference_weight
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
