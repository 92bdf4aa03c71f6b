"""Projection of ellipsoids: closed forms, the oracle's covariance, and what must be culled."""

import math

import numpy as np
import pytest
import torch

from gaussian_enhancer.splat import ewa
from gaussian_enhancer.splat.oracle import rotations
from gaussian_enhancer.types import identity_camera

WHITE = math.sqrt(0.5 * math.log2(math.e))


def shape_of(
    means: list[list[float]], scales: list[list[float]], logits: list[float], smoothing: float = 0.0, seed: int = 0
) -> ewa.Shape:
    n = len(means)
    quaternions = torch.randn(n, 4, generator=torch.Generator().manual_seed(seed)).numpy()
    return ewa.Shape(
        np.array(means, np.float32).reshape(n, 3), np.log(np.array(scales, np.float32)).reshape(n, 3),
        quaternions, np.array(logits, np.float32), np.full(n, smoothing, np.float32),
    )  # fmt: skip


def covariance(shape: ewa.Shape, focal: float, dilation: float) -> np.ndarray:
    """The textbook product for Gaussians on no clamp, camera at the origin."""
    x, y, z = shape.means.astype(float).T
    zero = np.zeros_like(z)
    J = np.array([[focal / z, zero, -focal * x / z**2], [zero, focal / z, -focal * y / z**2]]).transpose(2, 0, 1)
    R = rotations(torch.tensor(shape.quaternions, dtype=torch.float64)).numpy()
    M = J @ R * np.exp(shape.log_scales.astype(float))[:, None, :]
    return M @ M.transpose(0, 2, 1) + dilation * np.eye(2)


def test_whitening_is_the_inverse_covariances_factor() -> None:
    draw = np.random.default_rng(0)
    means = np.column_stack([draw.uniform(-0.5, 0.5, (50, 2)), draw.uniform(1.5, 4.0, 50)])
    shape = shape_of(means.tolist(), np.exp(draw.normal(size=(50, 3)) - 2).tolist(), [2.0] * 50)
    found = ewa.project(shape, ewa.view_of(identity_camera(60, 80, 70.0), 0.01), 0.3, False)
    cov = covariance(shape, 70.0, 0.3)
    rows = found.whitening[:, :4].reshape(50, 2, 2) / WHITE
    product = rows.transpose(0, 2, 1) @ rows
    np.testing.assert_allclose(product @ cov, np.tile(np.eye(2), (50, 1, 1)), atol=1e-9)


def test_needles_of_axis_ratio_a_million_keep_their_width() -> None:
    shape = shape_of([[0.01, 0.02, 2.0]] * 20, [[1e-3, 1e3, 1e-3]] * 20, [4.0] * 20)
    found = ewa.project(shape, ewa.view_of(identity_camera(64, 64, 64.0), 0.01), 0.3, False)
    # The narrow axis of the footprint has the variance dilation + thin^2.
    steepest = np.linalg.norm(found.whitening[:, :2], axis=1) / WHITE
    np.testing.assert_allclose(steepest**-2, 0.3 + (64e-3 / 2) ** 2, rtol=0.02)


def test_mip_filter_keeps_the_energy_of_a_small_gaussian() -> None:
    shape = shape_of([[0.0, 0.0, 2.0]] * 2, [[0.01] * 3, [0.0005] * 3], [6.0, 6.0])
    view = ewa.view_of(identity_camera(64, 64, 64.0), 0.01)
    found = ewa.project(shape, view, 0.1, True)
    variance = (32 * np.array([0.01, 0.0005])) ** 2
    factor = variance / (variance + 0.1)
    expected = np.log2(factor / (1 + np.exp(-6.0)))
    assert found.whitening[0, 4] == pytest.approx(expected[0], rel=1e-4)
    assert found.footprints[0, 2] > 0
    assert expected[1] < math.log2(1 / 255)
    assert found.footprints[1, 2] == 0  # its share falls below 1/255 everywhere


def test_behind_the_camera_at_the_near_plane_transparent_or_not_finite_is_culled() -> None:
    means = [[0, 0, 2.0], [0, 0, -2.0], [0, 0, 0.0], [0, 0, 0.5], [0, 0, 0.5001], [0, 0, 2.0], [math.nan, 0, 2.0]]
    scales = [[0.1] * 3] * 7
    shape = shape_of(means, scales, [0.0, 0.0, 0.0, 0.0, 0.0, -6.0, 0.0])
    shape.quaternions[0] = [1, 0, 0, 0]
    found = ewa.project(shape, ewa.view_of(identity_camera(8, 8, 8.0), 0.5), 0.3, False)
    assert (found.footprints[:, 2] > 0).tolist() == [True, False, False, False, True, False, False]
    shape.quaternions[0] = 0
    assert ewa.project(shape, ewa.view_of(identity_camera(8, 8, 8.0), 0.5), 0.3, False).footprints[0, 2] == 0


def test_scales_that_overflow_are_culled_not_infinite() -> None:
    shape = shape_of([[0, 0, 2.0]] * 2, [[1.0] * 3] * 2, [0.0, 0.0])
    shape.log_scales[1] = 500.0
    found = ewa.project(shape, ewa.view_of(identity_camera(8, 8, 8.0), 0.01), 0.3, False)
    assert np.isfinite(found.footprints).all()
    assert found.footprints[1, 2] == 0
