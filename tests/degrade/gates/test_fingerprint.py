import itertools
import json
import math

import pytest
import torch

from gaussian_enhancer.degrade.gates.fingerprint import (
    ENERGIES,
    Fingerprint,
    error_energies,
    fingerprint_of_training_views,
    measure_fingerprint,
    smooth,
)
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from support.textured_photo import textured_photo

SIZE = (72, 96)


def grid(size=SIZE):
    return torch.meshgrid(torch.arange(size[0]) + 0.5, torch.arange(size[1]) + 0.5, indexing="ij")


def blurred(photo):
    return smooth(photo[None], 1.2)[0] - photo


def noise(photo, seed=5):
    return 0.05 * torch.randn(photo.shape, generator=torch.Generator().manual_seed(seed))


def needles(photo):
    y, x = grid()
    lines = sum(
        torch.exp(-(((y - a) * math.cos(t) - (x - b) * math.sin(t)) ** 2) / 2)
        * torch.exp(-(((x - b) * math.cos(t) + (y - a) * math.sin(t)) ** 2) / 200)
        for a, b, t in ((20, 20, 0.3), (50, 60, 1.9), (30, 75, 0.9))
    )
    return 0.3 * lines.expand(3, -1, -1)


def bands(photo):
    y, x = grid()
    return 0.1 * torch.sin(2 * math.pi * (0.5 * x + 0.8 * y) / 16).expand(3, -1, -1)


def veil(photo):
    return torch.full_like(photo, 0.1)


def blob(photo):
    y, x = grid()
    return 0.5 * torch.exp(-((y - 40) ** 2 + (x - 30) ** 2) / 50).expand(3, -1, -1)


MADE = {
    "blur": blurred,
    "noise": noise,
    "anisotropy": needles,
    "banding": bands,
    "low_frequency": veil,
    "floater": blob,
}


def of(residual, photo):
    return error_energies(photo + residual, photo)


def test_a_perfect_render_has_no_energy():
    assert torch.equal(of(0, textured_photo(SIZE)), torch.zeros(6, dtype=torch.float64))


@pytest.mark.parametrize("name", ENERGIES)
def test_each_error_shows_in_its_own_energy_more_than_any_other_error_of_the_same_size_does(name):
    photo = textured_photo(SIZE)
    shares = {}
    for other, make in MADE.items():
        residual = make(photo)
        shares[other] = of(residual / residual.square().mean().sqrt() * 0.05, photo)[ENERGIES.index(name)].item()
    assert max((share, other) for other, share in shares.items() if other != name)[0] * 1.5 < shares[name], shares


@pytest.mark.parametrize("name", ["blur", "noise", "banding", "low_frequency", "floater"])
def test_the_largest_energy_names_the_error(name):
    photo = textured_photo(SIZE)
    assert ENERGIES[int(of(MADE[name](photo), photo).argmax())] == name


@pytest.mark.parametrize("name", ENERGIES)
def test_energies_grow_with_the_square(name):
    photo = textured_photo(SIZE)
    residual = MADE[name](photo)
    torch.testing.assert_close(of(2 * residual, photo), 4 * of(residual, photo), rtol=1e-2, atol=1e-8)


@pytest.mark.parametrize("pair", list(itertools.combinations(ENERGIES, 2)), ids="+".join)
def test_energies_of_independent_errors_add_up(pair):
    photo = textured_photo(SIZE)
    one, other = (MADE[name](photo) for name in pair)
    # The veil would hide in the others' mean: what is asked is that errors without a common part add up.
    apart = [
        residual - residual.mean() if name != "low_frequency" else residual
        for residual, name in zip((one, other), pair, strict=True)
    ]
    summed = sum(of(residual, photo) for residual in apart)
    together = of(sum(apart), photo)
    for name in pair:
        i = ENERGIES.index(name)
        assert 0.6 * summed[i] < together[i] < 1.6 * summed[i], name


def test_detail_energies_part_the_whole_and_known_values_hold():
    photo = textured_photo(SIZE)
    lost = of(noise(photo), photo)
    assert lost[1] == pytest.approx(0.05**2, rel=0.25)
    assert lost[0] < 0.06 * lost[1]
    assert of(veil(photo), photo)[4] == pytest.approx(0.1**2, rel=1e-3)
    half = of(-0.5 * (photo - smooth(photo[None], 1.5)[0]), photo)
    assert half[1] < 0.2 * half[0]


def test_flips_and_quarter_turns_change_nothing():
    photo = textured_photo((64, 64))
    render = photo + 0.05 * torch.randn(3, 64, 64, generator=torch.Generator().manual_seed(3))
    render[:, 20:30, 5:50] += 0.2
    expected = error_energies(render, photo)
    torch.testing.assert_close(error_energies(render.flip(2), photo.flip(2)), expected, rtol=1e-3, atol=1e-9)
    turned = error_energies(render.rot90(1, (1, 2)), photo.rot90(1, (1, 2)))
    torch.testing.assert_close(turned, expected, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("size", [(1, 1), (2, 7), (16, 16), (31, 200)])
def test_any_size_gives_finite_energies(size):
    generator = torch.Generator().manual_seed(0)
    found = error_energies(torch.rand(3, *size, generator=generator), torch.rand(3, *size, generator=generator))
    assert found.isfinite().all()
    assert (found >= 0).all()
    assert found.sum() > 0


def test_views_count_alike_and_in_any_order():
    pairs = [(photo + noise(photo, 7), photo) for photo in (textured_photo(SIZE, 1), textured_photo(SIZE, 2))]
    large = (torch.full((3, 96, 96), 0.6), torch.full((3, 96, 96), 0.5))
    found = measure_fingerprint(*zip(*pairs, large, strict=True))
    mean = torch.stack([error_energies(*pair) for pair in (*pairs, large)]).mean(0)
    torch.testing.assert_close(found.energies(), mean)
    torch.testing.assert_close(measure_fingerprint(*zip(large, *pairs, strict=True)).energies(), mean)
    assert found.views == 3


def test_reads_training_views_and_not_the_held_out_ones():
    photo = textured_photo(SIZE)
    clean, spoilt = RenderedView("a.png", lambda: photo, read_photo=lambda: photo), photo + 0.5
    target = RenderedView("b.png", lambda: spoilt, read_photo=lambda: photo)
    seen = RenderedView("c.png", lambda: photo + veil(photo), read_photo=lambda: photo)
    found = fingerprint_of_training_views(RenderedSet("run", (target,), (clean, seen)))
    assert found.views == 2
    assert found.low_frequency == pytest.approx(0.1**2 / 2, rel=1e-3)
    unrendered = RenderedView("d.png", None, read_photo=lambda: photo)
    with pytest.raises(InputError, match="run: has no training view"):
        fingerprint_of_training_views(RenderedSet("run", (target,), (unrendered,)))


def test_survives_json(tmp_path):
    photo = textured_photo(SIZE)
    found = measure_fingerprint([photo + noise(photo)], [photo])
    found.to_json(tmp_path / "fingerprint.json")
    assert Fingerprint(**json.loads((tmp_path / "fingerprint.json").read_text())) == found
    assert all(name in found.table() for name in ENERGIES)


GOOD = {**dict.fromkeys(ENERGIES, 0.01), "views": 3}


@pytest.mark.parametrize(("name", "value"), [("blur", -0.1), ("banding", math.nan), ("views", 0)])
def test_refuses_a_number_out_of_range_by_name(name, value):
    with pytest.raises(InputError, match=name):
        Fingerprint(**{**GOOD, name: value})


def test_refuses_images_that_make_no_pairs():
    photo = textured_photo(SIZE)
    for renders, photos in (([], []), ([photo], []), ([photo], [photo[:, 1:]]), ([photo * math.nan], [photo])):
        with pytest.raises(InputError):
            measure_fingerprint(renders, photos)
