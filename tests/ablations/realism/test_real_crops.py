"""Crops with most of an error of one kind."""

import torch

from ablations.realism.real_crops import KINDS, crops, cut, energies_of, places, worst
from gaussian_enhancer.degrade.artefact_types import ARTEFACTS
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.fingerprint import ENERGIES


def wall(size: int = 96) -> torch.Tensor:
    """A photo with some texture everywhere."""
    return 0.5 + 0.05 * torch.rand(3, size, size, generator=torch.Generator().manual_seed(0))


def test_crops_overlap_by_half_and_stay_within():
    found = list(places(96, 128, (32, 64)))
    assert found[:2] == [(0, 0), (0, 32)]
    assert max(found) == (64, 64)
    image = torch.arange(96.0 * 128).view(1, 96, 128)
    assert cut(image, (64, 64), (32, 64)).shape == (1, 32, 64)
    assert int(cut(image, (64, 64), (32, 64))[0, 0, 0]) == 64 * 128 + 64


def test_needles_are_found_where_they_are():
    photo = wall()
    render = photo.clone()
    for offset in range(0, 24, 6):
        render[:, 56 + offset, 60:90] = 0.9
    best = worst(crops([(photo, photo), (render, photo)], (32, 32)), "anisotropy")
    assert best.view == 1
    assert best.place[0] >= 48
    assert best.place[1] >= 48


def test_what_a_render_lacks_counts_less_than_what_it_adds():
    """A pole that is not there is the largest error, and no artefact."""
    photo = wall()
    photo[:, :, 10:16] = 0.0
    render = photo.clone()
    render[:, :, 10:16] = 0.5
    render[:, 70:73, 56:92] = 0.8
    found = crops([(render, photo)], (32, 32))
    largest = max(found, key=lambda crop: float(crop.energies.sum()))
    assert largest.place[1] == 0
    assert worst(found, "banding").place[1] >= 32
    assert worst(found, "blur").place[1] == 0  # lost detail is a loss


def test_without_any_that_keeps_contrast_the_worst_is_shown():
    photo = wall()
    found = crops([(torch.full_like(photo, 0.5), photo)], (48, 48))
    assert worst(found, "anisotropy") in found
    assert energies_of(found).shape == (len(found), len(ENERGIES))


def test_every_kind_is_an_energy_and_every_type_an_artefact():
    assert set(KINDS.values()) <= set(ENERGIES)
    assert set(KINDS) <= set(ARTEFACTS)


def test_each_type_of_a_splat_raises_the_error_it_stands_for():
    """At full strength its own energy is larger than before it by far."""
    photo = wall(128)[None]
    for name, kind in KINDS.items():
        view = View(photo, torch.full((1, 1, 128, 128), 5.0))
        generators = [torch.Generator().manual_seed(1)]
        made = ARTEFACTS[name](view, torch.ones(1), generators).image[0]
        own = energies_of(crops([(made, photo[0])], (128, 128)))[0, ENERGIES.index(kind)]
        assert own > 1e-6, name
