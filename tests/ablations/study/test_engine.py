"""The engine that measures studies, keeps their rows and makes their tables."""

import dataclasses

import pytest
import torch
from omegaconf import OmegaConf

from ablations.study.engine import Study, job, measure_study
from gaussian_enhancer.errors import InputError

TABLE = {"by": {"row": "row"}, "columns": {"psnr": "{psnr.mean:.1f}"}, "title": "Toy", "section": "row"}


def toy(parts, psnr=1.0) -> Study[str]:
    return Study(parts, lambda part: [{"row": part, "psnr": psnr}], ("row",), option="rows")


def killed(part):
    """Measure, but die at the part b."""
    if part == "b":
        raise KeyboardInterrupt
    return [{"row": part, "psnr": 9.0}]


def configured(tmp_path, **values):
    runtime = {"device": "cpu", "threads": 1, "keep_memory": False, "progress": False}
    return OmegaConf.create({"runtime": runtime, "records": None, "row_table": TABLE, **values})


def test_a_study_that_was_killed_goes_on_where_it_stopped(tmp_path):
    path, done = str(tmp_path / "rows.jsonl"), []

    def measure(part):
        if part == "b" and "b" not in done:
            done.append("b")
            raise KeyboardInterrupt
        done.append(part)
        return [{"row": part, "psnr": float(len(done))}]

    study = Study(("a", "b", "c"), measure, ("row",))
    with pytest.raises(KeyboardInterrupt):
        measure_study(study, path, "0123")
    assert not (tmp_path / "rows.jsonl").exists()
    frame = measure_study(study, path, "0123")
    assert done == ["a", "b", "b", "c"]
    assert frame["row"].tolist() == ["a", "b", "c"]
    assert [one.name for one in tmp_path.iterdir()] == ["rows.jsonl"]


def test_parts_are_known_by_their_text_and_not_by_their_place(tmp_path):
    path = str(tmp_path / "rows.jsonl")

    with pytest.raises(KeyboardInterrupt):
        measure_study(Study(("a", "b"), killed, ("row",)), path, "0123")
    frame = measure_study(toy(("0", "a", "b")), path, "0123")
    assert dict(zip(frame["row"], frame["psnr"], strict=True)) == {"0": 1.0, "a": 9.0, "b": 1.0}


def test_another_command_does_not_go_on_with_what_was_killed(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        measure_study(Study(("a", "b"), killed, ("row",)), str(tmp_path / "rows.jsonl"), "0123")
    assert measure_study(toy(("a", "b")), str(tmp_path / "rows.jsonl"), "4567")["psnr"].tolist() == [1.0, 1.0]


def test_earlier_rows_stay_and_those_measured_again_are_replaced(tmp_path):
    path = str(tmp_path / "rows.jsonl")
    measure_study(toy(("a", "b")), path)
    frame = measure_study(toy(("b", "c"), 2.0), path)
    assert dict(zip(frame["row"], frame["psnr"], strict=True)) == {"a": 1.0, "b": 2.0, "c": 2.0}
    before = (tmp_path / "rows.jsonl").read_bytes()
    assert measure_study(toy(()), path).equals(frame)  # without a part the records alone
    assert (tmp_path / "rows.jsonl").read_bytes() == before


def test_a_study_may_write_reports_of_its_own(tmp_path, capsys):
    reported = dataclasses.replace(toy(("a",)), report=lambda: 3.0)
    assert job(lambda cfg, device: reported)(configured(tmp_path)) == 3.0
    assert capsys.readouterr().out == ""


def test_whole_records_are_those_of_one_command_and_stay_without_a_part(tmp_path):
    path = tmp_path / "rows.jsonl"
    one = dataclasses.replace(toy(("a", "b")), replaces_file=True)
    assert measure_study(one, str(path))["row"].tolist() == ["a", "b"]
    assert measure_study(dataclasses.replace(one, parts=("c",)), str(path))["row"].tolist() == ["c"]
    before = path.read_bytes()
    assert measure_study(dataclasses.replace(one, parts=()), str(path))["row"].tolist() == ["c"]
    assert path.read_bytes() == before

    with pytest.raises(KeyboardInterrupt):
        measure_study(dataclasses.replace(one, measure=killed), str(path))
    assert path.read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == ["rows.jsonl"]


def test_several_studies_are_measured_before_the_last_one_reports(tmp_path):
    def report():
        return float(sum(len((tmp_path / f"{name}.jsonl").read_text().splitlines()) for name in ("one", "two")))

    one, two = (dataclasses.replace(toy(("a", "b")), records=tmp_path / f"{name}.jsonl") for name in ("one", "two"))
    last = dataclasses.replace(toy(()), report=report)
    assert job(lambda cfg, device: [one, two, last])(configured(tmp_path)) == 4.0


def test_a_file_of_something_else_is_refused_before_anything_is_measured(tmp_path):
    (tmp_path / "other.jsonl").write_text('{"psnr": 1}\n')

    def measure(part):
        raise AssertionError("was measured")

    with pytest.raises(InputError, match="lacks the column row; measure again, with runs="):
        measure_study(Study(("a",), measure, ("row",)), str(tmp_path / "other.jsonl"))


def test_nothing_measured_is_refused_with_the_option_that_measures():
    with pytest.raises(InputError, match="hold no row; measure, with rows="):
        measure_study(toy(()), None)


def test_a_job_prints_the_table_and_writes_the_page(tmp_path, capsys):
    cfg = configured(tmp_path, records=str(tmp_path / "rows.jsonl"), page=str(tmp_path / "page.md"))
    cfg.row_table.sections = {"a": "Section a"}
    job(lambda cfg, device: toy(("a", "b")))(cfg)
    assert capsys.readouterr().out.splitlines()[2:] == ["| a | 1.0 |", "| b | 1.0 |"]
    assert "## Section a\n\n| row | psnr |" in (tmp_path / "page.md").read_text()
    job(lambda cfg, device: toy(()) if isinstance(device, torch.device) else None)(cfg)
    assert "| b | 1.0 |" in capsys.readouterr().out
