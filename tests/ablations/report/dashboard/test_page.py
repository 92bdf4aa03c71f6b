"""What is inside the page: every record once, nothing that could run, nothing from outside; runs and pictures."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from ablations.report.dashboard.folder import TableRecords, all_records, read_folder
from ablations.report.dashboard.page import document
from ablations.report.dashboard.pictures import copy_pictures
from ablations.report.dashboard.runs import MOST_POINTS, flatten, read_curves, source_runs
from ablations.study.description import write_description
from gaussian_enhancer.errors import InputError
from support.dashboard_samples import NASTY, QUALITY, measured, write_results, write_runs
from support.page_data import page_data


@pytest.fixture(scope="module")
def listed(tmp_path_factory: pytest.TempPathFactory) -> tuple[TableRecords, ...]:
    return read_folder(write_results(tmp_path_factory.mktemp("results")))


def data(text: str) -> dict:
    return page_data(text, "dashboard-data")


def test_every_record_is_embedded_once_and_unrounded(listed: tuple[TableRecords, ...]) -> None:
    packed = data(document("Suite", listed))
    columns, pools = packed["records"], packed["pools"]
    records = listed[0].records
    assert len(columns["checksum"]) == len(records) < len(all_records(listed))
    for place, own in zip(packed["tables"][0]["records"], records, strict=True):
        for name in ("scene", "splat", "view", "variant", "commit", "machine", "time", "run", "kind"):
            assert pools[name][columns[name][place]] == getattr(own, name)
        assert columns["seed"][place] == own.seed
        assert dict(pools["sources"][columns["sources"][place]]) == own.sources
        assert dict(pools["reasons"][columns["reasons"][place]]) == own.reasons
        for metric, values in columns["values"].items():
            assert values[place] == own.metrics.get(metric)
    assert [columns["checksum"][i] for i in packed["tables"][1]["records"]] == list(listed[1].checksums)


def test_nothing_in_the_page_can_run_or_load(listed: tuple[TableRecords, ...]) -> None:
    text = document(NASTY, listed)
    assert text.count("<script") == 2
    assert "<img src=x" not in text
    assert not re.search(r'(?:src|href)="(?!data:)', text)
    assert "default-src 'none'" in text


def test_tables_come_in_the_order_of_their_numbers(listed: tuple[TableRecords, ...]) -> None:
    assert [one.table.name for one in listed] == ["table_2", "table_10"]


def test_what_cannot_be_read_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is no folder"):
        read_folder(tmp_path / "none")
    with pytest.raises(InputError, match="contains no description"):
        read_folder(tmp_path)
    write_results(tmp_path)
    (tmp_path / "lonely.jsonl").write_text("")
    with pytest.raises(InputError, match=r"lonely\.jsonl"):
        read_folder(tmp_path)
    (tmp_path / "lonely.jsonl").unlink()
    path = tmp_path / "table_2.jsonl"
    path.write_text(path.read_text().replace('"psnr": 2', '"psnr": 3', 1))
    with pytest.raises(InputError, match=r"table_2\.jsonl line 1: was changed"):
        read_folder(tmp_path)


def test_names_may_hold_what_other_programs_take_for_a_line_end(tmp_path: Path) -> None:
    strange = [replace(one, view=f"a\u2028{one.view}") for one in measured()]
    listed = read_folder(write_results(tmp_path, strange))
    assert [len(one.checksums) for one in listed] == [len(one.records) for one in listed]
    assert {one.view for one in listed[1].records} == {f"a\u2028{name}.png" for name in "abc"}
    assert len(data(document("Suite", listed))["records"]["checksum"]) == len(listed[0].records)


def test_a_table_without_records_is_there_and_says_so(tmp_path: Path) -> None:
    write_description(tmp_path / "table_2.json", QUALITY)
    (table,) = data(document("Suite", read_folder(tmp_path)))["tables"]
    assert table["absent"] == "no records yet: make the table"
    assert {number["reasons"][0] for line in table["lines"] for number in line["numbers"]} == {
        "yard: no record",
        "yard, seed 0: no record",
    }


def test_runs_are_read_as_far_as_they_lie_here(tmp_path: Path) -> None:
    runs = source_runs(write_runs(tmp_path), measured())
    found = {(run.job, run.name): run for run in runs}
    gepp = found["train", "gepp-seed1"]
    assert [curve.name for curve in gepp.curves] == ["gain/psnr", "train/total"]
    assert gepp.curves[1].values[:2] == (0.5, 1 / 12)
    assert gepp.settings["fusion.refine._target_"] == '"a.B"'
    assert gepp.absent == {}
    assert found["train", "ge-seed0"].absent == {"settings": "the run kept none", "curves": "the run kept none"}
    assert found["train", "ge-seed1"].absent["curves"] == "the run is not on this machine"
    assert found["fit", "scene0-3dgs"].absent == {"settings": "the run is not on this machine"}


def test_settings_are_flat_and_keep_lists_of_plain_values() -> None:
    assert flatten({"a": {"b": [1, 2], "c": [{"d": None}]}, "e": {}}) == {"a.b": "[1, 2]", "a.c.0.d": "null", "e": "{}"}


def test_long_logs_are_thinned_with_both_ends(tmp_path: Path) -> None:
    lines = "".join(f"{step},{step}.5,nan\n" for step in range(3 * MOST_POINTS))
    (tmp_path / "metrics.csv").write_text(f"step,loss,broken\n{lines}")
    (curve,) = read_curves(tmp_path / "metrics.csv")
    assert len(curve.steps) == MOST_POINTS
    assert (curve.steps[0], curve.steps[-1], curve.values[-1]) == (0, 3 * MOST_POINTS - 1, 3 * MOST_POINTS - 0.5)
    assert curve.logged == 3 * MOST_POINTS


def test_a_damaged_log_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "metrics.csv").write_text("step,loss\n1,few\n")
    with pytest.raises(InputError, match=r"metrics\.csv: is no log of numbers"):
        read_curves(tmp_path / "metrics.csv")


def test_pictures_are_copied_once_at_their_size(listed: tuple[TableRecords, ...], tmp_path: Path) -> None:
    runs = write_runs(tmp_path / "runs")
    found = copy_pictures(listed, runs, tmp_path / "page", count=2)
    assert sorted({view.scene for view in found.shown}) == sorted({NASTY, "yard"})
    assert len(found.shown) == 4
    for view in found.shown:
        assert set(view.files) == {"render", "photo", "gepp"}
        assert view.methods == {"gepp": "GE++"}
        for name in view.files.values():
            assert re.fullmatch(r"images/[0-9a-f]{20}\.png", name)
            assert Image.open(tmp_path / "page" / name).size == view.size == (24, 16)
    yard = next(view for view in found.shown if view.scene == "yard")
    source = runs / "enhance/scene0-3dgs-gepp-0/test/ours_30/enhanced" / yard.view
    assert (tmp_path / "page" / yard.files["gepp"]).read_bytes() == source.read_bytes()
    assert found.missing["yard · 3dgs · GE"] == "the enhanced run scene0-3dgs-ge-0 is not on this machine"


def test_large_pictures_become_jpeg_of_the_same_size(
    listed: tuple[TableRecords, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ablations.report.dashboard.pictures.LARGEST_COPY", 10)
    found = copy_pictures(listed, write_runs(tmp_path / "runs"), tmp_path / "page", count=1)
    file = tmp_path / "page" / found.shown[0].files["gepp"]
    with Image.open(file) as picture:
        assert (file.suffix, picture.format, picture.size) == (".jpg", "JPEG", (24, 16))
