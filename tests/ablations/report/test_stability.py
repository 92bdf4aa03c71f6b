"""The page and the diagrams of the stability study, from records."""

import math
import xml.etree.ElementTree as ElementTree

import pytest

from ablations.report.stability import COLOURS, matrix_plot, order_plot, stability_page
from ablations.stability.case import PRECISIONS
from ablations.stability.judge import FAILED, REFUSED, WITHIN, CaseOutcome, record_of
from ablations.stability.order import KIND as ORDER
from ablations.stability.order import slopes
from gaussian_enhancer.metrics.records import Record
from support.strained_cases import case

ONE = case("fine", passes=("forward", "backward"))
CELLS = (
    CaseOutcome(WITHIN, "", 1e-6, 1e-4),
    CaseOutcome(WITHIN, "", 1e-6, 1e-4, "float32"),
    CaseOutcome(REFUSED, "x: is strained; rest", tolerance=1e-4),
    CaseOutcome(FAILED, "result is not finite", math.inf, 1e-4),
    CaseOutcome(FAILED, "RuntimeError: no <kernel>", tolerance=1e-4),
)


def records() -> list[Record]:
    return [record_of(ONE, precision, "forward", cell) for precision, cell in zip(PRECISIONS, CELLS, strict=True)]


def order_records(power: float = 1.0) -> list[Record]:
    return [
        Record(ORDER, "sampler", "cosine", "float64", "forward", str(n), {"steps": float(n), "error": n**-power})
        for n in (1, 4, 16, 64, 1000)
    ]


def test_the_page_shows_every_outcome_and_counts_them():
    page = stability_page([*records(), *order_records()], [ONE], {"matrix": "m.svg", "order": "o.svg"}, "r/s.jsonl")
    assert "| `fine` | fine | ✓ · | ◐ · | ⊘ · | ✗ · | ✗ · | 1.0e-06 |" in page
    assert "| all | 1 | 1 | 1 | 2 |" in page
    assert "refused, `fine` float16 forward: x: is strained; rest" in page
    assert "FAILED, `fine` autocast bfloat16 forward: result is not finite" in page
    assert "| `cosine` | 1.0e+00 | 2.5e-01 | 1.6e-02 | 1.0e-03 | 1.00 |" in page
    assert "![The matrix in colour](m.svg)" in page


def test_the_matrix_is_a_picture_of_the_records():
    text = matrix_plot(records())
    ElementTree.fromstring(text)
    for colour in COLOURS.values():
        assert text.count(f"fill: {colour}") >= 2  # a cell and the legend
    for words in (f"{ONE.family}: fine", "float32, forward"):
        assert words in text


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_the_order_is_the_slope_at_the_end(power):
    assert slopes(order_records(power))["cosine"] == pytest.approx(power)
    assert ElementTree.fromstring(order_plot(order_records(power))) is not None
