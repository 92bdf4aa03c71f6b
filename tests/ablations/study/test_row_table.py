"""Tables of rows by templates."""

import math

import pandas as pd
import pytest

from ablations.study.markdown import markdown
from ablations.study.row_table import TableLayout, page, row_table

FRAME = pd.DataFrame(
    {
        "row": ["b", "b", "b", "a"],
        "scene": ["s", "s", "t", "t"],
        "psnr": [1.0, -0.5, 0.25, math.nan],
        "views": [3, 3, 3, 4],
    }
)


def table(**layout: object) -> list[list[str]]:
    found = row_table(FRAME, TableLayout(**{"by": {"row": "method"}, "columns": {}, **layout}))
    return [list(found.columns), *found.to_numpy().tolist()]


@pytest.mark.parametrize(
    ("template", "first"),
    [
        ("{psnr.mean:+.2f}", "+0.25"),
        ("{psnr.median:.2f}", "0.25"),
        ("{psnr.min:+.1f} to {psnr.max:+.1f}", "-0.5 to +1.0"),
        ("{psnr.count}", "3"),
        ("{psnr.negatives}", "1 of 3"),
        ("{psnr.positives}", "2 of 3"),
        ("{views}", "3"),
        ("{psnr:.1f}", "1.0"),
        ("{psnr.interval:.1f}", "too few views"),
    ],
)
def test_a_template_names_statistics_of_a_group(template, first):
    assert table(columns={"psnr": template})[1] == ["b", first]


def test_what_was_not_measured_is_unknown_and_a_column_that_nobody_measured_is_left_out():
    columns = {"psnr": "{psnr.mean:.2f}", "worse": "{psnr.negatives}", "ssim": "{ssim.mean:.2f}"}
    assert table(columns=columns) == [["method", "psnr", "worse"], ["b", "0.25", "1 of 3"], ["a", "-", "-"]]
    assert table(columns=columns, unknown="none")[2] == ["a", "none", "none"]


def test_groups_have_the_order_of_rows_or_of_their_names():
    assert [line[0] for line in table()] == ["method", "b", "a"]
    assert [line[0] for line in table(ordered=True)] == ["method", "a", "b"]


def test_a_column_a_value_and_groups_over_all_values():
    assert table(across={"scene": "{psnr.mean:.2f}"}) == [["method", "s", "t"], ["b", "0.25", "0.25"], ["a", "-", "-"]]
    found = table(by={"row": "method", "scene": "scene"}, total="row", columns={"views": "{views}"})
    assert found[1:] == [*[["b", "s", "3"], ["b", "t", "3"], ["a", "t", "4"]], *[["all", "s", "3"], ["all", "t", "3"]]]


def test_a_page_has_a_table_a_section_and_leaves_out_those_without_rows():
    sections = {"t": "Second", "u": "None", "s": "First"}
    layout = TableLayout(
        {"row": "row"}, {"n": "{psnr.count}"}, title="T", about="A", section="scene", sections=sections
    )
    text = page(FRAME, layout, ["above"], ["below"])
    tables = [markdown(row_table(FRAME[FRAME["scene"] == name], layout)) for name in ("t", "s")]
    assert text == f"# T\n\nA\n\nabove\n\n## Second\n\n{tables[0]}\n\n## First\n\n{tables[1]}\n\nbelow\n"
