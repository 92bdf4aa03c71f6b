import os
import time
from pathlib import Path

import numpy as np
import pytest

from gaussian_enhancer.measure.cost import peak_memory, timed


def test_repeats_are_interleaved_after_the_warm_up() -> None:
    order: list[str] = []
    found = timed({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, repeats=3, warm_up=1)
    assert "".join(order) == "ab" + "ab" * 3
    assert len(found["a"].repeats) == 3


def test_times_are_wall_clock_milliseconds_and_the_median_ignores_a_hiccup() -> None:
    naps = iter([0.005, 0.1, 0.005])
    found = timed({"nap": lambda: time.sleep(next(naps))}, repeats=3, warm_up=0)["nap"]
    assert 5 <= found.milliseconds < 60
    assert max(found.repeats) >= 100
    assert found.deviation > 10


def test_no_repeats_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        timed({}, repeats=0)


def test_the_peak_is_that_of_the_call_and_not_of_an_earlier_one() -> None:
    switch = Path("/proc/self/clear_refs")
    if not switch.exists() or not os.access(switch, os.W_OK):
        pytest.skip("this system does not let a process reset its memory's high-water mark")
    megabyte = 2**20
    large = peak_memory(lambda: np.ones(200 * megabyte, np.uint8).sum())
    small = peak_memory(lambda: np.ones(20 * megabyte, np.uint8).sum())
    assert 120 * megabyte < large - small < 280 * megabyte
