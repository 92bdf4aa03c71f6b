"""Plots: valid documents with equal bytes for equal numbers, the front that is marked, names that are text."""

import math
import xml.etree.ElementTree as ET

import pytest

from ablations.study.plots import Mark, Panel, bar_panels, category_matrix, convergence, front_of_curves, work_precision

CURVES = {
    "fast": (Mark("x", 1.0, 0.1), Mark("y", 10.0, 0.01, 9.0, 12.0)),
    "slow": (Mark("z", 20.0, 0.05), Mark("w", 100.0, 0.001)),
}


def panel(curves: dict[str, tuple[Mark, ...]], **options) -> Panel:
    return Panel("easy", "time, ms", "error", curves, **options)


def texts(svg: str) -> set[str]:
    return {"".join(element.itertext()) for element in ET.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")}


@pytest.mark.parametrize("odd", [0.0, -1.0, math.nan, math.inf])
def test_what_has_no_place_on_the_axes_is_left_out(odd) -> None:
    assert not Mark("", odd, 1.0).drawable
    assert not Mark("", 1.0, odd).drawable
    found = texts(work_precision("", [panel({"a": (Mark("gone", odd, 1.0), Mark("there", 1.0, 1.0))})], 1))
    assert "a, there" in found
    assert "a, gone" not in found


def test_the_front_alone_is_named_and_every_method_stands_in_the_legend() -> None:
    assert [point.name for point in front_of_curves(CURVES, None)] == ["fast, x", "fast, y", "slow, w"]
    found = texts(work_precision("A diagram", [panel(CURVES)], 1))
    assert {"fast, x", "fast, y", "slow, w", "time, ms", "error", "easy", "A diagram", "fast", "slow"} <= found
    assert "slow, z" not in found


def test_what_is_no_better_than_the_baseline_is_not_on_the_front() -> None:
    curves = {"a": (Mark("worse", 1.0, 0.2), Mark("better", 2.0, 0.05))}
    assert [point.name for point in front_of_curves(curves, 0.1)] == ["a, better"]
    assert "raw, 3 ms/MP" in texts(work_precision("", [panel(curves, baseline=("raw, 3 ms/MP", 0.1))], 1))


def test_an_empty_panel_says_so() -> None:
    assert "nothing was measured" in texts(work_precision("", [panel({}), panel(CURVES)], 2))


@pytest.mark.parametrize("name", ["<script>&", "$x^2$", "_hidden", "naïve ✓"])
def test_names_are_text_whatever_they_hold(name) -> None:
    found = texts(work_precision(name, [panel({name: (Mark("one", 1.0, 1.0),)})], 1))
    assert {name, f"{name}, one"} <= found


def test_equal_numbers_give_equal_bytes() -> None:
    made = [
        lambda: work_precision("title", [panel(CURVES)], 1),
        lambda: bar_panels("title", [("times", {"a": 1.5, "b": -0.2}, (1.0,), "%.2f")]),
        lambda: category_matrix(
            "title", {("r", "c"): "good"}, ["r", "s"], ["c"], {"good": "#00ff00", "bad": "#ff0000"}
        ),
        lambda: convergence("title", {"a": [(1.0, 1.0), (10.0, 0.1)]}, "steps", "error"),
    ]
    for make in made:
        assert make() == make()
        assert "<title>title</title>" in make()
