"""Studies beside the suite's tables: their tables from records, their diagrams copied as they are."""

import pytest

from ablations.report.dashboard.folder import TableRecords
from ablations.report.dashboard.page import document
from ablations.report.dashboard.studies import NOTES, StudyView, copy_diagrams, read_study
from ablations.report.plan_study import PlanAims
from ablations.stability.judge import FAILED, KIND, WITHIN
from ablations.study.markdown import markdown
from ablations.study.plots import Mark, Panel, work_precision
from gaussian_enhancer.metrics.records import Record, write_records
from support.dashboard_samples import NASTY, QUALITY
from support.paths import DOCS

AIMS = PlanAims("full", "auto", 1.5, 0.98, 0.02)


def test_diagrams_are_copied_and_named_by_their_titles(tmp_path) -> None:
    panel = Panel("all", "ms", "error", {"a": (Mark("x", 1.0, 1.0),)})
    text = work_precision(NASTY, [panel], 1)
    (tmp_path / "lr.svg").write_text(text, encoding="utf-8")
    (tmp_path / "left_out.svg").write_text("<svg><rect><title>of a mark, not of the whole</title></rect></svg>")
    found = copy_diagrams([tmp_path / "lr.svg", tmp_path / "left_out.svg"], tmp_path / "page")
    assert found == (
        {"title": NASTY, "file": "diagrams/lr.svg"},
        {"title": "left out", "file": "diagrams/left_out.svg"},
    )
    assert (tmp_path / "page/diagrams/lr.svg").read_text(encoding="utf-8") == text


@pytest.mark.parametrize("name", NOTES)
def test_a_study_that_was_not_measured_says_how_it_is(name, tmp_path) -> None:
    study = read_study(name, tmp_path / "none.jsonl", tmp_path, tmp_path / "page", AIMS)
    assert study.absent.endswith(f"{NOTES[name][0]}.")
    assert study.absent in document("Suite", [TableRecords(QUALITY)], studies=[study])
    assert not (tmp_path / "page").exists()


def test_a_matrix_is_counted_by_family(tmp_path) -> None:
    cells = [
        Record(KIND, family, "case", "float32", "forward", how, {"error": 0.0})
        for family, how in (("splats", WITHIN), ("splats", FAILED), ("images", WITHIN))
    ]
    write_records(tmp_path / "matrix.jsonl", cells)
    tables = read_study("stability", tmp_path / "matrix.jsonl", tmp_path, tmp_path / "page", AIMS).tables
    assert tables is not None
    assert list(tables) == ["Splats", "Images"]
    assert tuple(tables["Splats"].iloc[0]) == ("float32", "1", "0", "0", "1")
    assert tuple(tables["Images"].iloc[0]) == ("float32", "1", "0", "0", "0")


def test_what_plans_leave_out_is_shown_as_it_was_measured(tmp_path) -> None:
    study = read_study(
        "plan", DOCS / "results/leaving_out_test.jsonl", DOCS / "results/leaving_out.svg", tmp_path, AIMS
    )
    assert [one["file"] for one in study.diagrams] == ["diagrams/leaving_out.svg"]
    assert study.tables is not None
    table = study.tables["auto against full"]
    page = (DOCS / "results/plan.md").read_text(encoding="utf-8")
    assert len(table)
    assert markdown(table) in page


def test_the_page_is_told_of_its_studies() -> None:
    found = document(
        "Suite",
        [TableRecords(QUALITY)],
        studies=[StudyView("plan", "As read.", ({"title": "Error", "file": "diagrams/lr.svg"},))],
    )
    assert '"diagrams":[{"title":"Error","file":"diagrams/lr.svg"}]' in found
    assert '"note":"As read."' in found
