import math

import pytest
import torch
import torch.nn.functional as F

from ablations.realism.spectrum import ROUNDING, radial_spectrum, spectrum_distance
from gaussian_enhancer.errors import InputError


def noise(seed, height=64, width=96, deviation=0.1):
    generator = torch.Generator().manual_seed(seed)
    return deviation * torch.randn(3, height, width, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("size", [(64, 64), (64, 96), (128, 80)])
def test_white_noise_has_its_variance_at_every_frequency_and_size(size):
    mean = torch.stack([radial_spectrum(noise(seed, *size), 8) for seed in range(12)]).mean(dim=0)
    torch.testing.assert_close(mean, torch.full((8,), -20.0, dtype=torch.float64), atol=0.7, rtol=0)


def test_a_wave_shows_in_its_ring_and_the_mean_does_not_show():
    x = torch.arange(128, dtype=torch.float64)
    wave = 0.5 + 0.1 * torch.cos(2 * math.pi * 0.28 * x).expand(1, 128, 128)
    spectrum = radial_spectrum(wave, 8)
    assert spectrum.argmax() == int(0.28 * 16)
    floor = 10 * math.log10(ROUNDING)
    assert radial_spectrum(torch.full((3, 32, 32), 0.7), 8).tolist() == pytest.approx([floor] * 8)


def test_distance_is_zero_for_a_set_and_itself_and_known_for_louder_noise():
    quiet, loud = [noise(i) for i in range(6)], [2 * noise(i) for i in range(6)]
    assert spectrum_distance(quiet, quiet) == 0
    assert spectrum_distance(quiet, loud) == pytest.approx(20 * math.log10(2), abs=0.02)
    assert spectrum_distance(loud, quiet) == spectrum_distance(quiet, loud)


def test_blur_is_far_from_white_noise_the_more_the_wider():
    white = [noise(i) for i in range(4)]

    def blurred(width):
        return [F.avg_pool2d(one[None], width, 1, width // 2)[0] for one in white]

    far = [spectrum_distance(white, blurred(width)) for width in (3, 5, 7)]
    assert 3 < far[0] < far[1] < far[2]


def test_does_not_depend_on_the_direction():
    one = F.avg_pool2d(noise(0, 64, 64)[None], (1, 5), 1, (0, 2))[0]
    torch.testing.assert_close(radial_spectrum(one), radial_spectrum(one.rot90(1, (1, 2))))


def test_refuses_an_image_with_too_few_frequencies():
    with pytest.raises(InputError, match="fewer than 16 rings"):
        radial_spectrum(noise(0, 8, 8))
