import pytest
import torch

from ablations.realism.patches import RenderPair, cut_patches, eight_bit, patch_places
from gaussian_enhancer.errors import InputError


def image(seed, height=40, width=56):
    return torch.randint(0, 256, (3, height, width), generator=torch.Generator().manual_seed(seed), dtype=torch.uint8)


def pair(scene="s", view="v", seed=0):
    photo = image(seed)
    return RenderPair(scene, view, photo, 255 - photo, photo // 2)


def test_eight_bit_rounds_to_the_nearest_step_and_clamps():
    values = torch.tensor([-1.0, 0.0, 0.49 / 255, 0.51 / 255, 1.0, 7.0]).view(1, 1, 6)
    assert eight_bit(values).flatten().tolist() == [0, 0, 0, 1, 255, 255]


def test_places_lie_inside_do_not_overlap_and_vary():
    seen = set()
    for seed in range(20):
        places = patch_places(image(0), 16, 100, torch.Generator().manual_seed(seed))
        assert len(places) == 6
        covered = torch.zeros(40, 56)
        for y, x in places:
            assert 0 <= y <= 40 - 16
            assert 0 <= x <= 56 - 16
            covered[y : y + 16, x : x + 16] += 1
        assert covered.max() == 1
        seen.add(min(places))
    assert len(seen) > 5
    assert len(patch_places(image(0), 16, 4, torch.Generator().manual_seed(0))) == 4


def test_plain_background_is_left_out():
    photo = torch.full((3, 40, 56), 255, dtype=torch.uint8)
    photo[:, :, 30:] = image(1)[:, :, 30:]
    for seed in range(5):
        places = patch_places(photo, 16, 100, torch.Generator().manual_seed(seed))
        assert places
        assert all(x + 16 > 30 for _, x in places)
    plain = torch.zeros(3, 40, 56, dtype=torch.uint8)
    with pytest.raises(InputError, match="no patch that shows anything"):
        cut_patches([RenderPair("s", "v", plain, plain, plain)], size=16)


def test_patches_of_both_kinds_come_from_the_same_places_whatever_the_renders():
    pairs = [pair("a", "0", 0), pair("a", "0", 0), pair("b", "0", 2)]
    cut = cut_patches(pairs, size=16, per_pair=3)
    assert torch.equal(cut.simulated, 255 - cut.photo)
    assert torch.equal(cut.real, cut.photo // 2)
    assert cut.views == (("a", "0"), ("b", "0"))
    assert cut.view.tolist() == [0] * 6 + [1] * 3
    assert cut.scene.tolist() == [0] * 6 + [1] * 3
    other = cut_patches([RenderPair(p.scene, p.view, p.photo, p.photo, p.photo) for p in pairs], size=16, per_pair=3)
    assert torch.equal(other.photo, cut.photo)
    assert not torch.equal(cut_patches(pairs, size=16, per_pair=3, seed=1).photo, cut.photo)


def test_index_keeps_places_together():
    cut = cut_patches([pair("a", "0", 0), pair("b", "1", 2)], size=16, per_pair=3)
    some = cut[torch.tensor([4, 0])]
    assert torch.equal(some.real, some.photo // 2)
    assert some.scene.tolist() == [1, 0]
    assert len(some) == 2


def test_refuses_other_sizes_and_too_large_patches():
    with pytest.raises(InputError, match="give images of one size"):
        RenderPair("s", "v", image(0), image(0), image(0, 41))
    with pytest.raises(InputError, match="smaller than 64"):
        cut_patches([pair()], size=64)
