"""Diagrams beside the dashboard: copied as they are, named by their own titles, none where there are none."""

from dashboard_samples import NASTY, QUALITY

from gaussian_enhancer.report.dashboard.diagrams import Diagram, copy_diagrams
from gaussian_enhancer.report.dashboard.folder import Listed
from gaussian_enhancer.report.dashboard.page import document
from gaussian_enhancer.report.diagram import Mark, Panel, diagram


def test_diagrams_are_copied_and_named_by_their_titles(tmp_path) -> None:
    (tmp_path / "source").mkdir()
    panel = Panel("all", "ms", "error", {"a": (Mark("x", 1.0, 1.0),)})
    text = diagram(NASTY, [panel], 1)
    (tmp_path / "source/lr.svg").write_text(text, encoding="utf-8")
    (tmp_path / "source/notes.txt").write_text("no diagram")
    assert copy_diagrams(tmp_path / "source", tmp_path / "page") == (Diagram(NASTY, "diagrams/lr.svg"),)
    assert (tmp_path / "page/diagrams/lr.svg").read_text(encoding="utf-8") == text


def test_without_a_folder_there_is_no_diagram(tmp_path) -> None:
    assert copy_diagrams(tmp_path / "nowhere", tmp_path / "page") == ()
    assert not (tmp_path / "page").exists()


def test_the_page_is_told_of_its_diagrams() -> None:
    found = document("Suite", [Listed(QUALITY)], diagrams=[Diagram("Error", "diagrams/lr.svg")])
    assert '"diagrams":[{"title":"Error","file":"diagrams/lr.svg"}]' in found
    assert "drawTradeoff" in found
