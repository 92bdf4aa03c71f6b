import math

import pytest
import torch

from ablations.realism.anisotropy import anisotropy_distance, coherence, coherence_histogram


def noise(seed, size=64):
    return torch.rand(3, size, size, generator=torch.Generator().manual_seed(seed))


def stripes(angle, size=64):
    y, x = torch.meshgrid(torch.arange(float(size)), torch.arange(float(size)), indexing="ij")
    return (0.5 + 0.4 * torch.sin(0.5 * (math.cos(angle) * x + math.sin(angle) * y))).expand(3, size, size)


@pytest.mark.parametrize("angle", [0.0, 0.4, math.pi / 2, 2.5])
def test_stripes_are_coherent_in_any_direction(angle):
    inner = coherence(stripes(angle))
    assert inner.median() > 0.97


def test_noise_is_not_coherent_and_averages_out_in_wider_neighbourhoods():
    means = [coherence(noise(0), sigma).mean().item() for sigma in (1.0, 2.0, 4.0)]
    assert means[0] > means[1] > means[2]
    assert means[1] < 0.4


def test_noise_smeared_along_one_direction_is_more_coherent():
    isotropic = [noise(i) for i in range(3)]
    oriented = [torch.nn.functional.avg_pool2d(one[None], (1, 9), 1, (0, 4))[0] for one in isotropic]
    far = anisotropy_distance(isotropic, oriented)
    # with every coherence moved upwards, the distance is the difference of the means
    means = [torch.cat([coherence(one) for one in side]).mean().item() for side in (isotropic, oriented)]
    assert far == pytest.approx(means[1] - means[0], abs=0.01)
    assert far > 0.2


def test_distance_is_zero_for_itself_symmetric_and_nearly_one_at_most():
    one, other = [noise(0)], [stripes(0.3)]
    assert anisotropy_distance(one, one) == 0
    assert anisotropy_distance(one, other) == pytest.approx(anisotropy_distance(other, one))
    assert 0.5 < anisotropy_distance(one, other) < 1
    assert anisotropy_distance(one, [one[0].rot90(1, (1, 2))]) < 0.01


def test_flat_images_have_no_direction_and_do_not_count():
    flat = torch.full((3, 32, 32), 0.5)
    assert coherence(flat).numel() == 0
    assert coherence_histogram([flat]).sum() == 0
    torch.testing.assert_close(coherence_histogram([flat, noise(1)]), coherence_histogram([noise(1)]))
    assert coherence_histogram([noise(1)]).sum() == pytest.approx(1)
