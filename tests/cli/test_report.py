"""The job ``report``: from a measured run's folder to the page, nothing else at hand."""

from pathlib import Path

import pytest
import torch
from PIL import Image

from gaussian_enhancer.cli import measure, report
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record, read_records, write_records
from support.job_config import job_config
from support.page_data import page_data


def job(name: str, *overrides: str):
    return job_config(name, *overrides, "runtime.threads=1", "runtime.progress=false")


@pytest.fixture
def measured(tmp_path: Path) -> Path:
    """A measured run of two views, its times recorded."""
    noise = torch.Generator().manual_seed(0)
    run = tmp_path / "run"
    costs = []
    for view in ("a.png", "b.png"):
        photo = torch.rand(32, 40, 3, generator=noise)
        error = 0.2 * torch.randn(32, 40, 3, generator=noise)
        for subfolder, image in (("gt", photo), ("renders", photo + error), ("enhanced", photo + 0.5 * error)):
            path = run / "test" / "ours_7" / subfolder / view
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray((image.clamp(0, 1) * 255).round().byte().numpy()).save(path)
        costs.append(Record("cost", "run", "yard", "3dgs", view, "enhanced", {"milliseconds": 7.5}))
    write_records(run / "records.jsonl", costs)
    (run / "config.yaml").write_text("weights: sif_small\n")
    folder = tmp_path / "measured"
    measure.run(job("measure", f"run={run}", f"output={folder}", "lpips=[lpips_alex]"))
    return folder


def test_the_page_holds_the_records(measured: Path) -> None:
    report.run(job("report", f"measured={measured}", "contact_sheet=true"))
    shown = page_data((measured / "report.html").read_text(encoding="utf-8"))
    records = {(r.view, r.variant): r for r in read_records(measured / "records.jsonl")}
    assert [view["name"] for view in shown["views"]] == ["a.png", "b.png"]
    for view in shown["views"]:
        for variant in ("raw", "enhanced"):
            metrics = records[view["name"], variant].metrics
            assert view[variant] == {key: value for key, value in metrics.items() if value is not None}
        assert view["milliseconds"] == 7.5
    assert shown["title"] == "run · ours_7"
    assert shown["provenance"]["Weights"] == "sif_small"
    assert Image.open(measured / "contact_sheet.png").width > 3 * 240


def test_the_page_goes_where_it_is_wanted(measured: Path, tmp_path: Path) -> None:
    report.run(job("report", f"measured={measured}", f"output={tmp_path / 'page'}", "title=Mine"))
    assert page_data((tmp_path / "page" / "report.html").read_text(encoding="utf-8"))["title"] == "Mine"


def test_refuses_what_was_not_measured_or_only_half(measured: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no finished measure job"):
        report.run(job("report", f"measured={tmp_path / 'run'}"))
    side = tmp_path / "run" / "test" / "ours_7"
    half = tmp_path / "half"
    measure.run(job("measure", f"images={side / 'renders'}", f"photos={side / 'gt'}", f"output={half}", "lpips=[]"))
    with pytest.raises(InputError, match="not of raw and enhanced"):
        report.run(job("report", f"measured={half}"))


def test_refuses_when_the_images_are_gone(measured: Path, tmp_path: Path) -> None:
    (tmp_path / "run").rename(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="holds no renders any more"):
        report.run(job("report", f"measured={measured}"))
    assert not (measured / "report.html").exists()
