"""The 3D filter follows the finest photo that sees a Gaussian."""

import dataclasses
import math

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.filters import filter_size
from gaussian_enhancer.types import identity_camera


def test_size_is_that_of_the_finest_camera() -> None:
    wide, tele = identity_camera(20, 30, 50.0), identity_camera(20, 30, 200.0)
    means = torch.tensor([[0.0, 0.0, 2.0], [0.5, 0.0, 2.0], [0.0, 0.0, 8.0]])
    # The second lies outside the long lens's image (50 px right of a centre at 15 px) but inside the other's.
    expected = math.sqrt(0.2) * torch.tensor([2 / 200, 2 / 50, 8 / 200])
    torch.testing.assert_close(filter_size(means, [wide, tele]), expected)


def test_margin_counts_and_what_nobody_sees_takes_the_largest() -> None:
    camera = identity_camera(20, 30, 50.0)
    at_edge = 0.64 * 30 / 50  # x / z within 1.15 widths
    means = torch.tensor([[at_edge * 3, 0.0, 3.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [9.0, 0.0, 1.0]])
    size = filter_size(means, [camera])
    torch.testing.assert_close(size, math.sqrt(0.2) / 50 * torch.tensor([3.0, 1.0, 3.0, 3.0]))


def test_longer_of_two_focal_lengths_counts() -> None:
    camera = identity_camera(20, 30, 50.0)
    camera = dataclasses.replace(camera, K=camera.K * torch.tensor([[1.0], [1.5], [1.0]]))
    size = filter_size(torch.tensor([[0.0, 0.0, 1.0]]), [camera])
    assert size.item() == pytest.approx(math.sqrt(0.2) / 75)


def test_unseen_splats_are_refused_and_empty_ones_are_not() -> None:
    camera = identity_camera(20, 30, 50.0)
    with pytest.raises(InputError, match="see none of the 1"):
        filter_size(torch.tensor([[0.0, 0.0, -1.0]]), [camera])
    with pytest.raises(InputError, match="0 see none"):
        filter_size(torch.zeros(2, 3), [])
    assert filter_size(torch.zeros(0, 3), []).shape == (0,)
