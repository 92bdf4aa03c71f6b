"""Compiled spherical harmonics against the oracle's, values and gradients, degrees 0 to 3."""

import numpy as np
import pytest
import torch

from gaussian_enhancer.splat.oracle import sh_values
from gaussian_enhancer.splat.sh import shade, shade_backward

CENTRE = np.array([0.3, -0.2, 0.1])


def drawn(count: int, coefficients: int) -> tuple[torch.Tensor, torch.Tensor]:
    draw = torch.Generator().manual_seed(coefficients)
    return torch.randn(count, 3, generator=draw), torch.randn(count, coefficients, 3, generator=draw) * 1.5


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_values_and_gradients_equal_the_oracles(coefficients: int) -> None:
    means, sh = drawn(200, coefficients)
    a, b = means.double().requires_grad_(), sh.double().requires_grad_()
    expected = (sh_values(b, torch.nn.functional.normalize(a - torch.tensor(CENTRE), dim=-1)) + 0.5).clamp_min(0)
    wanted = np.ones(200, bool)
    colours = shade(means.numpy(), sh.numpy(), CENTRE, wanted)
    np.testing.assert_allclose(colours, expected.detach(), atol=1e-5)
    assert (colours == 0).any()  # the cut-off at black is exercised

    gradient = torch.randn(200, 3, generator=torch.Generator().manual_seed(1))
    (expected * gradient).sum().backward()
    by_mean = np.zeros((200, 3), np.float32)
    by_sh = shade_backward(means.numpy(), sh.numpy(), CENTRE, wanted, colours, gradient.numpy(), by_mean)
    expected_by_mean = torch.zeros(200, 3) if a.grad is None else a.grad
    np.testing.assert_allclose(by_sh, b.grad, atol=1e-5)
    np.testing.assert_allclose(by_mean, expected_by_mean, atol=1e-5 * max(1.0, float(expected_by_mean.abs().max())))


def test_unwanted_gaussians_stay_black_and_pass_nothing_back() -> None:
    means, sh = drawn(4, 4)
    wanted = np.array([True, False, True, False])
    colours = shade(means.numpy(), sh.numpy(), CENTRE, wanted)
    by_mean = np.full((4, 3), 7.0, np.float32)
    by_sh = shade_backward(means.numpy(), sh.numpy(), CENTRE, wanted, colours, np.ones((4, 3), np.float32), by_mean)
    assert (colours[~wanted] == 0).all()
    assert (by_sh[~wanted] == 0).all()
    assert (by_mean[~wanted] == 7).all()


def test_a_gaussian_at_the_cameras_centre_is_finite() -> None:
    means = CENTRE.astype(np.float32)[None]
    colours = shade(means, np.ones((1, 16, 3), np.float32), means[0].astype(np.float64), np.ones(1, bool))
    assert np.isfinite(colours).all()
