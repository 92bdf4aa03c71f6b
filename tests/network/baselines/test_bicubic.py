import dataclasses

import pytest
import torch

from gaussian_enhancer.infer.weights import build_design, count_parameters, design_of
from gaussian_enhancer.network.baselines.bicubic import Bicubic
from support.networks import views


@pytest.mark.parametrize("size", [(1, 1), (5, 3), (16, 24)])
def test_equals_bicubic_interpolation(size):
    seen, network = views(*size), build_design(design_of(Bicubic()))
    expected = torch.nn.functional.interpolate(
        seen.render, (4 * size[0], 4 * size[1]), mode="bicubic", align_corners=False
    )
    torch.testing.assert_close(network(seen), expected)
    assert count_parameters(network) == 0


def test_keeps_constants_and_does_not_clamp():
    seen = views(8, 8)
    constant = dataclasses.replace(seen, render=torch.full((1, 3, 8, 8), 0.3))
    torch.testing.assert_close(Bicubic()(constant), torch.full((1, 3, 32, 32), 0.3))
    edge = (torch.arange(8) > 3).float().expand(1, 3, 8, 8)
    upsampled = Bicubic()(dataclasses.replace(seen, render=edge))
    assert upsampled.min() < -0.01
    assert upsampled.max() > 1.01
