import csv
import io
import math

import pytest

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.comparison import (
    Table,
    compare,
    format_value,
    gain_table,
    metrics_of,
    pair_records,
    view_table,
)
from gaussian_enhancer.metrics.records import Record


def record(view: str, variant: str, scene: str = "fox", **metrics: float | None) -> Record:
    reasons = {name: "not measured: no backbone" for name, value in metrics.items() if value is None}
    return Record("quality", "run", scene, "3dgs", view, variant, dict(metrics), reasons, commit="c", machine="m")


RECORDS = [
    record("b.png", "enhanced", psnr=21.0, lpips_alex=0.2),
    record("a.png", "raw", psnr=20.0, lpips_alex=0.3),
    record("b.png", "raw", psnr=20.5, lpips_alex=0.3),
    record("a.png", "enhanced", psnr=22.0, lpips_alex=0.4),
    record("c.png", "raw", psnr=math.inf, lpips_alex=None),
    record("c.png", "enhanced", psnr=math.inf, lpips_alex=0.1),
]


def test_views_are_paired_by_name_whatever_their_order() -> None:
    pairs = pair_records(RECORDS)
    assert [pair.baseline.view for pair in pairs] == ["a.png", "b.png", "c.png"]
    assert [pair.gain("psnr") for pair in pairs[:2]] == [2.0, 0.5]


def test_mean_deviation_and_worst_view() -> None:
    found = compare(pair_records(RECORDS), "psnr")
    assert (found.gain, found.count, found.worst, found.worst_gain) == (1.25, 2, "b.png", 0.5)
    assert found.deviation == pytest.approx(0.75 * math.sqrt(2))  # n - 1 in the denominator
    assert (found.baseline, found.variant) == (20.25, 21.5)
    assert found.left_out == {"c.png": "equal to the photo, or not measured on both"}


def test_worst_means_highest_where_lower_is_better() -> None:
    found = compare(pair_records(RECORDS), "lpips_alex")
    assert (found.worst, found.worst_gain) == ("a.png", pytest.approx(0.1))
    assert found.gain == pytest.approx(0.0)
    assert found.left_out == {"c.png": "not measured: no backbone"}


def test_a_single_view_has_no_deviation_and_none_has_no_gain() -> None:
    assert math.isnan(compare(pair_records(RECORDS[1:2] + RECORDS[3:4]), "psnr").deviation)
    assert math.isnan(compare(pair_records(RECORDS[4:]), "psnr").gain)


@pytest.mark.parametrize(
    ("records", "found"),
    [
        (RECORDS[:3], "a.png: was measured as 'raw' but not as 'enhanced'"),
        ([*RECORDS, RECORDS[1]], "measured twice as 'raw'"),
        ([], "no view measured as 'raw' and 'enhanced'"),
    ],
)
def test_what_cannot_be_paired_is_refused(records: list[Record], found: str) -> None:
    with pytest.raises(InputError, match=found):
        pair_records(records)


def test_scenes_are_kept_apart() -> None:
    other = [record("a.png", "raw", "tree", psnr=10.0), record("a.png", "enhanced", "tree", psnr=9.0)]
    rows = [row for row in gain_table(pair_records(RECORDS + other)).rows if row[2] == "psnr"]
    assert [(row[0], row[5], row[7]) for row in rows] == [("fox", "+1.25", "2 of 3"), ("tree", "-1.00", "1 of 1")]


def test_tables_as_text() -> None:
    table = Table(("a|b", "c"), (("1|2", "x, y"),))
    assert table.markdown() == "| a\\|b | c |\n| --- | --- |\n| 1\\|2 | x, y |\n"
    assert list(csv.reader(io.StringIO(table.csv()))) == [["a|b", "c"], ["1|2", "x, y"]]
    views = view_table(pair_records(RECORDS))
    assert views.columns[:6] == ("scene", "splat", "view", "psnr baseline", "psnr variant", "psnr gain")
    assert views.rows[2][3:] == ("inf", "inf", "", "", "0.1000", "")
    assert metrics_of(pair_records(RECORDS)) == ("psnr", "lpips_alex")


def test_numbers_are_written_with_the_digits_of_their_metric() -> None:
    assert format_value("psnr_aligned", 1.005, signed=True) == "+1.00"
    assert format_value("ssim", 0.5) == "0.5000"
    assert format_value("ssim", None) == ""
