import pytest

from gaussian_enhancer.metrics import cost
from gaussian_enhancer.metrics.cost import time_interleaved


def test_repeats_are_interleaved_after_the_warm_up() -> None:
    order: list[str] = []
    found = time_interleaved({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, repeats=3, warm_up=1)
    assert "".join(order) == "ab" + "ab" + "ba" + "ab"
    assert len(found["a"].repeats) == 3


def test_times_are_wall_clock_milliseconds_and_the_median_ignores_a_hiccup(monkeypatch) -> None:
    now, naps = [1.0], iter([0.25, 4.0, 0.25])

    def nap() -> None:
        now[0] += next(naps)

    monkeypatch.setattr(cost.time, "perf_counter", lambda: now[0])
    found = time_interleaved({"nap": nap}, repeats=3, warm_up=0)["nap"]
    assert found.milliseconds == 250
    assert found.repeats == (250, 4000, 250)


def test_no_repeats_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        time_interleaved({}, repeats=0)
