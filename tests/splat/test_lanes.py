"""Vectors of sixteen in compiled code against the same arithmetic in NumPy."""

import numpy as np
import pytest

from gaussian_enhancer.compiled import inner
from gaussian_enhancer.splat.lanes import (
    broadcast,
    exp2_of,
    lane_indices,
    load,
    magnitude,
    minimum,
    prefetch,
    select_less,
    store,
    store_sums,
)
from gaussian_enhancer.splat.planes import scratch


@inner
def _arithmetic(values, scalar, out):  # type: ignore[no-untyped-def]
    memory = scratch(1)
    memory[:32] = values
    prefetch(out, 0)
    a, b = load(memory, 0), load(memory, 16)
    results = (
        a + b, a - scalar, scalar * b, a / b, magnitude(a - b), minimum(a, scalar), select_less(a, b, scalar, a),
        select_less(scalar, a, b, broadcast(scalar)), lane_indices(), scalar - a,
    )  # fmt: skip
    for k in range(len(results)):
        store(memory, 32 + 16 * k, results[k])
    out[:] = memory[32:192].reshape(10, 16)


def test_operators_and_choices() -> None:
    values = np.random.default_rng(0).normal(size=32).astype(np.float32)
    a, b, s = values[:16], values[16:], np.float32(0.3)
    out = np.zeros((10, 16), np.float32)
    _arithmetic(values, s, out)
    expected = [
        a + b, a - s, s * b, a / b, abs(a - b), np.minimum(a, s), np.where(a < b, s, a), np.where(s < a, b, s),
        np.arange(16), s - a,
    ]  # fmt: skip
    np.testing.assert_allclose(out, np.stack(expected), rtol=1e-6)


@inner
def _powers(values, out):  # type: ignore[no-untyped-def]
    memory = scratch(1)
    for k in range(len(values) // 16):
        memory[:16] = values[16 * k : 16 * k + 16]
        store(memory, 16, exp2_of(load(memory, 0)))
        out[16 * k : 16 * k + 16] = memory[16:32]


def test_powers_of_two() -> None:
    values = np.linspace(-126, 0, 16_000, dtype=np.float32)
    out = np.empty_like(values)
    _powers(values, out)
    np.testing.assert_allclose(out, np.exp2(values.astype(float)), rtol=3e-7)


@inner
def _sums(values, out):  # type: ignore[no-untyped-def]
    memory = scratch(1)
    memory[:48] = values
    store_sums(out, 1, (load(memory, 0), load(memory, 16), load(memory, 32)))


def test_sums_over_lanes_fill_a_row() -> None:
    values = np.random.default_rng(1).uniform(size=48).astype(np.float32)
    out = np.full((3, 16), 7, np.float32)
    _sums(values, out)
    np.testing.assert_allclose(out[1, :3], values.reshape(3, 16).sum(1), rtol=1e-6)
    assert (out[1, 3:] == 0).all()
    assert (out[[0, 2]] == 7).all()


@pytest.mark.parametrize("share", [np.nan, np.inf])
def test_what_is_not_a_number_is_not_less(share: float) -> None:
    values = np.full(32, share, np.float32)
    values[16:] = 1
    out = np.zeros((10, 16), np.float32)
    _arithmetic(values, np.float32(0.5), out)
    assert not (out[6] == 0.5).any()
