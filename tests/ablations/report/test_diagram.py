"""Work-precision diagrams: axes, round ticks, the front that is drawn, names that cannot break the document."""

import math
import re
import xml.etree.ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ablations.report.axes import Axis, axis, ticks, told
from ablations.report.diagram import HEIGHT, WIDTH, Mark, Panel, diagram, drawable

POSITIVE = st.floats(1e-9, 1e9, allow_subnormal=False)
SVG = "{http://www.w3.org/2000/svg}"


def panel(curves: dict[str, tuple[Mark, ...]], **options) -> Panel:
    return Panel("easy", "time, ms", "error", curves, **options)


def drawn(*panels: Panel, columns: int = 2) -> ET.Element:
    return ET.fromstring(diagram("A diagram", panels, columns))


def texts(root: ET.Element) -> list[str]:
    return [element.text or "" for element in root.iter(f"{SVG}text")]


@given(POSITIVE, POSITIVE)
def test_ticks_lie_within_the_axis_rise_and_are_few(a, b) -> None:
    low, high = sorted((a, b))
    if high / low < 1.05:
        return
    found = ticks(low, high)
    assert all(low <= value <= high * (1 + 1e-6) for value in found)
    assert list(found) == sorted(set(found))
    assert 1 <= len(found) <= 12


def test_ticks_are_round() -> None:
    assert ticks(0.9, 1100.0) == (1, 10, 100, 1000)
    assert ticks(1.0, 50.0) == (1, 2, 5, 10, 20, 50)
    assert [round(value, 6) for value in ticks(0.0021, 0.0031)] == [0.0022, 0.0024, 0.0026, 0.0028, 0.003]


@pytest.mark.parametrize(
    ("value", "words"),
    [(1.0, "1"), (0.0022, "0.0022"), (20000.0, "20000"), (1e-7, "10⁻⁷"), (2e-7, "2e-07"), (1e6, "10⁶")],
)
def test_numbers_on_axes(value, words) -> None:
    assert told(value) == words


@given(st.lists(POSITIVE, min_size=1, max_size=9))
def test_an_axis_holds_its_values_in_order(values) -> None:
    found = axis(values, 400.0)
    places = [found(value) for value in sorted(values)]
    assert places == sorted(places)
    assert all(0 < place < 400 for place in places)


def test_an_axis_is_logarithmic() -> None:
    across = Axis(1.0, 100.0, 200.0)
    assert [across(value) for value in (1.0, 10.0, 100.0)] == pytest.approx([0, 100, 200])


@pytest.mark.parametrize("odd", [0.0, -1.0, math.nan, math.inf])
def test_what_has_no_place_on_the_axes_is_left_out(odd) -> None:
    assert not drawable(Mark("", odd, 1.0))
    assert not drawable(Mark("", 1.0, odd))
    root = drawn(panel({"a": (Mark("gone", odd, 1.0), Mark("there", 1.0, 1.0))}))
    titles = [element.text for element in root.iter(f"{SVG}title")]
    assert any("there" in title for title in titles)
    assert not any("gone" in title for title in titles)


def test_marks_lie_where_the_axes_say_and_the_front_alone_is_ringed() -> None:
    curves = {
        "fast": (Mark("x", 1.0, 0.1), Mark("y", 10.0, 0.01)),
        "slow": (Mark("z", 20.0, 0.05), Mark("w", 100.0, 0.001)),
    }
    root = drawn(panel(curves))
    rings = [(float(c.get("cx")), float(c.get("cy"))) for c in root.iter(f"{SVG}circle")]
    across, down = axis([1.0, 10.0, 20.0, 100.0], WIDTH), axis([0.1, 0.01, 0.05, 0.001], HEIGHT)
    assert rings == [
        (pytest.approx(across(x), abs=0.1), pytest.approx(HEIGHT - down(y), abs=0.1))
        for x, y in ((1.0, 0.1), (10.0, 0.01), (100.0, 0.001))
    ]
    assert {"fast, x", "fast, y", "slow, w"} <= set(texts(root))
    assert "slow, z" not in texts(root)
    assert {"time, ms", "error", "easy", "A diagram", "fast", "slow"} <= set(texts(root))


def test_what_is_no_better_than_the_baseline_is_not_on_the_front() -> None:
    curves = {"a": (Mark("worse", 1.0, 0.2), Mark("better", 2.0, 0.05))}
    root = drawn(panel(curves, baseline=("raw, 3 ms/MP", 0.1)))
    assert len(list(root.iter(f"{SVG}circle"))) == 1
    assert "raw, 3 ms/MP" in texts(root)


def test_an_empty_panel_says_so_and_panels_fill_rows() -> None:
    assert "nothing was measured" in texts(drawn(panel({})))
    root = drawn(*[panel({"a": (Mark("x", 1.0, 1.0),)})] * 3)
    moves = [g.get("transform") for g in root.findall(f"{SVG}g")]
    tops = {re.match(r"translate\((\S+) (\S+)\)", move)[2] for move in moves}
    assert len(moves) == 3
    assert len(tops) == 2


@given(st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc"))))
def test_names_are_text_whatever_they_hold(name) -> None:
    root = drawn(panel({name: (Mark(name, 1.0, 1.0),)}))
    assert any(name in text for text in texts(root))


def test_colours_follow_the_readers_preference() -> None:
    text = diagram("", [panel({"a": (Mark("x", 1.0, 1.0),)})], 1)
    assert "prefers-color-scheme: dark" in text
