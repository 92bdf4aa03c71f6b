import dataclasses
import json
import math
from pathlib import Path

import pytest

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import (
    HIGHER_IS_BETTER,
    Record,
    read_checked,
    read_records,
    write_records,
)


def record(view: str = "a.png", **changes: object) -> Record:
    values = {
        "kind": "quality",
        "run": "fit-1",
        "scene": "Füchse",
        "splat": "3dgs",
        "view": view,
        "variant": "raw",
        "metrics": {"psnr": 20.125, "ssim": 1 / 3, "lpips_vgg": None},
        "reasons": {"lpips_vgg": "not measured: no backbone"},
        "size": (640, 480),
        "protocol": "8-bit",
    }
    return Record(**{**values, **changes})  # type: ignore[arg-type]


def test_records_are_read_back_as_they_were_written(tmp_path: Path) -> None:
    written = [record(), record("b.png", metrics={"psnr": math.inf, "ssim": 1.0})]
    write_records(tmp_path / "deep" / "records.jsonl", written)
    assert read_records(tmp_path / "deep" / "records.jsonl") == tuple(written)
    assert written[0].commit
    assert "cores" in written[0].machine
    for line in (tmp_path / "deep" / "records.jsonl").read_text(encoding="utf-8").splitlines():
        json.loads(line, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def test_a_metric_without_value_needs_a_reason() -> None:
    with pytest.raises(ValueError, match="psnr has neither a value nor a reason"):
        record(metrics={"psnr": None})


def test_every_changed_value_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    write_records(path, [record(), record("b.png"), record("c.png")])
    lines = path.read_text(encoding="utf-8").splitlines()
    for old, new in (("20.125", "21.125"), ("raw", "Raw"), ("640", "641"), ("no backbone", "no Backbone")):
        path.write_text("\n".join([lines[0], lines[1].replace(old, new), lines[2]]), encoding="utf-8")
        with pytest.raises(InputError, match=r"records\.jsonl line 2: was changed"):
            read_records(path)


def test_cut_and_foreign_lines_are_refused_by_place(tmp_path: Path) -> None:
    path = tmp_path / "records.jsonl"
    write_records(path, [record(), record("b.png")])
    whole = path.read_text(encoding="utf-8")
    path.write_text(whole[:-30], encoding="utf-8")
    with pytest.raises(InputError, match="line 2: is no record"):
        read_records(path)
    path.write_text('{"psnr": 30}\n' + whole, encoding="utf-8")
    with pytest.raises(InputError, match="line 1: is no record"):
        read_records(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="no UTF-8 text"):
        read_records(path)
    path.write_text("[" * 100_000)
    with pytest.raises(InputError, match="line 1: is no record"):
        read_records(path)
    with pytest.raises(InputError, match="does not exist; measure first"):
        read_records(tmp_path / "none.jsonl")


def test_records_cannot_be_changed() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        record().view = "b.png"  # type: ignore[misc]


def test_directions_are_data() -> None:
    assert HIGHER_IS_BETTER["psnr"] is True
    assert HIGHER_IS_BETTER["lpips_vgg_raw"] is False
    assert HIGHER_IS_BETTER["gaussians"] is None


def test_fields_that_came_later_are_written_where_they_say_something(tmp_path):
    plain = Record("quality", "r", "s", "3dgs", "0.png", "raw", {"psnr": 30.0})
    known = dataclasses.replace(plain, seed=0, sources={"train": "ge-01234567"})
    write_records(tmp_path / "r.jsonl", [plain, known])
    first, second = (tmp_path / "r.jsonl").read_text().splitlines()
    assert "seed" not in first
    assert '"seed": 0' in second
    assert read_records(tmp_path / "r.jsonl") == (plain, known)


def test_a_name_may_hold_what_other_programs_take_for_a_line_end(tmp_path):
    strange = Record("quality", "r", "s\u2028t\x85u", "3dgs", "0.png", "raw", {"psnr": 30.0})
    write_records(tmp_path / "r.jsonl", [strange])
    assert read_records(tmp_path / "r.jsonl") == (strange,)


def test_checksums_are_those_of_the_lines(tmp_path):
    write_records(tmp_path / "r.jsonl", [record(), record("b\u2028.png")])
    checked = read_checked(tmp_path / "r.jsonl")
    lines = (tmp_path / "r.jsonl").read_text(encoding="utf-8").split("\n")[:-1]
    assert [checksum for checksum, _ in checked] == [json.loads(line)["sha256"] for line in lines]
    assert tuple(one for _, one in checked) == read_records(tmp_path / "r.jsonl")
