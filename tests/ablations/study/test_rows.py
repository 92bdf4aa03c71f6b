"""Measurements as rows of a frame, and the file that keeps them."""

import math

import pytest

from ablations.study.rows import Measurement, RowFile, frame_of, line_of, with_gains, with_provenance
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record


@pytest.fixture
def rows(tmp_path) -> RowFile:
    return RowFile(tmp_path / "rows.jsonl", ("scene", "splat"), ("psnr",))


def add(rows: RowFile, *measurements: Measurement) -> None:
    rows.add_lines([line_of(measurement) for measurement in measurements])


def row(splat: str, psnr: float, scene: str = "plush") -> dict[str, object]:
    return {"scene": scene, "splat": splat, "psnr": psnr}


def test_rows_that_are_measured_again_replace_the_old_ones(rows):
    assert rows.read_or_empty().empty
    add(rows, row("raw", 20.0), row("new", 21.0), row("new", 22.0))
    first = rows.path.read_text().splitlines()[0]
    add(rows, row("new", 23.0), row("raw", 30.0, "copr"))
    assert rows.path.read_text().splitlines()[0] == first  # to the letter
    found = rows.read()
    assert found[["scene", "splat", "psnr"]].to_numpy().tolist() == [
        ["plush", "raw", 20.0],
        ["plush", "new", 23.0],
        ["copr", "raw", 30.0],
    ]


@pytest.mark.parametrize(
    ("text", "said"), [("no rows", "is no file of rows"), ('{"scene": "a"}\n', "lacks the column")]
)
def test_a_file_of_something_else_is_refused_and_kept(rows, text, said):
    rows.path.write_text(text)
    for act in (rows.read, rows.read_or_empty, lambda: add(rows, row("raw", 20.0))):
        with pytest.raises(InputError, match=f"{said}.*with runs="):
            act()
    assert rows.path.read_text() == text


def record(variant: str, psnr: float | None, view: str = "a.png") -> Record:
    return Record("quality", "run", "plush", "3dgs", view, variant, {"psnr": psnr}, {"psnr": "not measured"})


def test_records_keep_their_checksums_and_a_changed_one_is_refused(tmp_path):
    rows = RowFile(tmp_path / "records.jsonl", ("run", "view", "variant"))
    add(rows, record("raw", 20.0), record("new", None))
    add(rows, record("raw", 21.0))
    assert rows.read()["variant"].tolist() == ["new", "raw"]
    assert rows.read()["psnr"].isna().tolist() == [True, False]
    rows.path.write_text(rows.path.read_text().replace("21.0", "29.0"))
    with pytest.raises(InputError, match="line 2: was changed or damaged"):
        rows.read()


def test_numbers_that_are_not_finite_are_null_and_values_within_values_are_columns(tmp_path):
    rows = RowFile(tmp_path / "rows.jsonl", ("row",))
    add(rows, {"row": "a", "blur": {"training": 1.0, "ratio": math.nan}})
    assert "NaN" not in rows.path.read_text()
    found = rows.read()
    assert found["blur training"].tolist() == [1.0]
    assert found["blur ratio"].isna().all()


def test_a_row_states_where_and_when_it_was_measured():
    assert {"commit", "machine", "time"} <= set(with_provenance({"row": "a"}))
    one = record("raw", 20.0)
    assert with_provenance(one) is one


def test_gains_are_over_the_baseline_of_the_same_keys():
    views = [record("raw", 20.0), record("new", 23.0), record("raw", 30.0, "b.png"), record("new", 29.0, "b.png")]
    frame = with_gains(frame_of([*views, record("new", 9.0, "c.png")]), {"variant": "raw"}, ("run", "view"))
    assert frame["gain psnr"].tolist()[:4] == [0, 3, 0, -1]
    assert math.isnan(frame["gain psnr"].iloc[4])  # without a baseline
