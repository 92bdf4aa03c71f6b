"""The job ``stability`` on two cases: records, page, diagrams, and the page again from records alone."""

from pathlib import Path

import pytest
from omegaconf import DictConfig

from ablations.jobs import stability
from ablations.report import stability as pages
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import read_records, write_records
from support.job_config import job_config


def configured(folder: Path, *overrides: str) -> DictConfig:
    paths = [f"records={folder / 'r/s.jsonl'}", f"markdown={folder / 'docs/s.md'}"]
    return job_config("stability", *paths, "runtime.threads=1", *overrides)


def test_cases_become_records_a_page_and_diagrams(tmp_path, monkeypatch):
    few = ["cases=[plus_1e4,black_objective]", "order.steps=[1,2,4]", "order.finest=8"]
    assert stability.run(configured(tmp_path, *few)) == 0
    records = read_records(tmp_path / "r/s.jsonl")
    assert len(records) == 2 * 5 * 2 + 3 * 6
    page, matrix, order = (tmp_path / f"docs/{name}" for name in ("s.md", "s/matrix.svg", "s/order.svg"))
    first = page.read_text()
    assert "| `plus_1e4` | offsets of 10000 pixels | ✓ ✓ |" in first
    assert "(../r/s.jsonl)" in first
    assert all("<svg" in drawing.read_text() for drawing in (matrix, order))
    drawn: dict[str, object] = {}
    monkeypatch.setattr(pages, "category_matrix", lambda title, cells, *rest: drawn.update(cells=cells) or "")
    monkeypatch.setattr(pages, "convergence", lambda title, curves, *rest: drawn.update(curves=curves) or "")
    pages.matrix_plot([record for record in records if record.kind == "stability"])
    pages.order_plot([record for record in records if record.kind == "sampler order"])
    assert len(drawn["cells"]) == 20
    assert sum(map(len, drawn["curves"].values())) == 18
    page.unlink()
    assert stability.run(configured(tmp_path, "records_only=true")) == 0
    assert page.read_text() == first


def test_what_cannot_be_made_is_refused(tmp_path):
    with pytest.raises(InputError, match="families"):
        stability.run(configured(tmp_path, "families=[splat]"))
    write_records(tmp_path / "r/s.jsonl", [])
    with pytest.raises(InputError, match="contain no cell"):
        stability.run(configured(tmp_path, "records_only=true"))
