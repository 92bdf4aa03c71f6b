"""The job ``dashboard``: a folder of results and the runs at hand become a page with pictures beside it."""

from pathlib import Path

import pytest

from ablations.jobs import dashboard
from gaussian_enhancer.errors import InputError
from support.dashboard_samples import write_results, write_runs
from support.job_config import job_config, run_job


def make(*overrides: str) -> None:
    run_job(dashboard.run, job_config("dashboard", *overrides))


def test_the_page_and_its_pictures_are_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_results(tmp_path / "desk")
    write_runs(tmp_path / "runs")
    make(f"folder={folder}", f"runs={tmp_path / 'runs'}", f"output={tmp_path / 'page'}")
    text = (tmp_path / "page" / "dashboard.html").read_text(encoding="utf-8")
    assert "<title>GaussianEnhancer suite · desk</title>" in text
    assert "2 of 5 settings" not in text
    assert '"gepp-seed1"' in text
    pictures = list((tmp_path / "page" / "images").iterdir())
    assert pictures
    assert all(picture.name in text for picture in pictures)
    told = capsys.readouterr().err
    assert "2 tables, 54 records, 4 views with pictures" in told
    assert str(tmp_path) not in text


def test_without_runs_the_page_says_what_it_lacks(tmp_path: Path) -> None:
    folder = write_results(tmp_path / "desk")
    runs = f"runs={tmp_path / 'none'}"
    make(f"folder={folder}", runs, "title=Mine", "images_per_scene=1")
    text = (tmp_path / "none" / "dashboard" / "dashboard.html").read_text(encoding="utf-8")
    assert "<title>Mine</title>" in text
    assert "the run is not on this machine" in text
    assert "the enhanced run scene0-3dgs-gepp-0 is not on this machine" in text
    assert not (tmp_path / "none" / "dashboard" / "images").exists()


def test_a_damaged_configuration_is_refused_by_name(tmp_path: Path) -> None:
    folder = write_results(tmp_path / "desk")
    runs = write_runs(tmp_path / "runs", pictures=False)
    (runs / "train" / "gepp-seed0" / "config.yaml").write_text("a: [1\n")
    with pytest.raises(InputError, match=r"gepp-seed0/config\.yaml"):
        make(f"folder={folder}", f"runs={runs}")
