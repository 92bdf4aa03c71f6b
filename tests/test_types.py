"""What the shared types work out from their fields."""

import torch

from gaussian_enhancer.types import Render


def test_surface_is_the_median_where_half_is_covered_and_the_expected_depth_elsewhere() -> None:
    expected = torch.tensor([[[2.0, 3.0, 0.0]]])
    median = torch.tensor([[[5.0, 0.0, 0.0]]])
    view = Render(torch.zeros(3, 1, 3), expected, torch.tensor([[[0.9, 0.3, 0.0]]]), median)
    assert view.surface.tolist() == [[[5.0, 3.0, 0.0]]]


def test_surface_is_the_expected_depth_where_no_median_is_known() -> None:
    expected = torch.tensor([[[2.0, 0.0]]])
    assert torch.equal(Render(torch.zeros(3, 1, 2), expected, torch.ones(1, 1, 2)).surface, expected)
