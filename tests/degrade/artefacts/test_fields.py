import pytest
import torch

from gaussian_enhancer.degrade.artefacts.fields import smooth_field
from support.generators import spawn_seeded


def test_varies_about_zero_by_about_one_and_slowly():
    field = smooth_field(3, 8, 128, 96, spawn_seeded(8), torch.zeros(1))
    assert field.shape == (8, 3, 128, 96)
    assert abs(float(field.mean())) < 0.05
    assert 0.7 < field.std() < 1.1
    assert (field[..., 1:] - field[..., :-1]).std() < 0.25
    assert abs(float((field[..., 24:] * field[..., :-24]).mean())) < 0.1


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (17, 33)])
def test_any_size(size):
    assert torch.isfinite(smooth_field(2, 8, *size, spawn_seeded(2), torch.zeros(1))).all()
