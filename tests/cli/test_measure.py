"""The measure job, from the command line to records and tables."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaussian_enhancer.cli import main as cli
from gaussian_enhancer.metrics.lpips import backbone_place
from gaussian_enhancer.metrics.records import read_records
from support.stand_in_backbone import write_vgg


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    draw = np.random.default_rng(0)
    for name in ("a", "b", "c"):
        photo = draw.integers(60, 190, (40, 48, 3), dtype=np.uint8)
        for folder, strength in (("photos", 0), ("raw", 30), ("enhanced", 15)):
            noise = draw.normal(0, strength, photo.shape)
            Path(folder).mkdir(exist_ok=True)
            Image.fromarray((photo + noise).clip(0, 255).astype(np.uint8)).save(f"{folder}/{name}.png")


def measure(*overrides: str) -> Path:
    cli.main(["measure", "output=out", "lpips=[lpips_alex]", *overrides])
    return Path("out")


def test_one_folder_gives_a_record_an_image(capsys: pytest.CaptureFixture[str]) -> None:
    out = measure("images=raw", "photos=photos", "scene_name=noise", "variant=noisy")
    records = read_records(out / "records.jsonl")
    assert [(r.view, r.scene, r.variant) for r in records] == [(f"{n}.png", "noise", "noisy") for n in "abc"]
    mean = np.mean([r.metrics["psnr"] for r in records])
    assert f"| noise |  | noisy | psnr | {mean:.2f} |" in capsys.readouterr().out
    assert (out / "done").is_file()


def test_names_may_consist_of_digits(capsys: pytest.CaptureFixture[str]) -> None:
    out = measure("images=raw", "photos=photos", "scene_name=2024", "splat_name=0", "variant=1")
    found = {(r.scene, r.splat, r.variant) for r in read_records(out / "records.jsonl")}
    assert found == {("2024", "0", "1")}
    assert "| 2024 | 0 | 1 | psnr |" in capsys.readouterr().out


def test_two_folders_are_compared(capsys: pytest.CaptureFixture[str]) -> None:
    out = measure("images=enhanced", "raw=raw", "photos=photos")
    records = read_records(out / "records.jsonl")
    gains = [records[i + 3].metrics["psnr"] - records[i].metrics["psnr"] for i in range(3)]
    assert min(gains) > 4
    row = next(r for r in csv.DictReader((out / "summary.csv").open()) if r["metric"] == "psnr")
    assert row["gain"] == f"{np.mean(gains):+.2f}"
    assert row["sd"] == f"{np.std(gains, ddof=1):.2f}"
    assert f"({min(gains):+.2f})" in row["worst view"]
    assert len(list(csv.DictReader((out / "views.csv").open()))) == 3
    assert "psnr_aligned" in capsys.readouterr().out


def test_measuring_again_replaces_the_records() -> None:
    measure("images=raw", "photos=photos")
    Image.open("photos/a.png").save("raw/a.png")
    records = read_records(measure("images=raw", "photos=photos") / "records.jsonl")
    assert records[0].metrics["psnr"] == math.inf
    assert len(records) == 3


def test_distances_that_nobody_asked_for_have_no_rows_without_a_backbone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "empty"))
    monkeypatch.setenv("GAUSSIAN_ENHANCER_DATA", str(tmp_path / "empty"))
    records = read_records(measure("images=raw", "photos=photos", "lpips=null") / "records.jsonl")
    assert set(records[0].metrics) == {"psnr", "psnr_aligned", "ssim"}
    assert "lpips" not in capsys.readouterr().out


def test_a_metric_without_backbone_is_told_and_not_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "empty"))
    monkeypatch.setenv("GAUSSIAN_ENHANCER_DATA", str(tmp_path / "empty"))
    records = read_records(measure("images=raw", "photos=photos", "lpips=[lpips_vgg]") / "records.jsonl")
    assert records[0].metrics["lpips_vgg"] is None
    assert records[0].reasons["lpips_vgg"].startswith("not measured: no backbone")
    assert f"not measured: no backbone; {backbone_place('lpips_vgg')}" in capsys.readouterr().out


def test_both_distances_by_vgg_are_measured_once_the_backbone_is_in_the_data_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "empty"))
    monkeypatch.setenv("GAUSSIAN_ENHANCER_DATA", str(tmp_path / "data"))
    names = ("lpips_vgg", "lpips_vgg_raw")
    words = ("images=raw", "photos=photos", f"lpips=[{','.join(names)}]")
    assert set(read_records(measure(*words) / "records.jsonl")[0].reasons) == set(names)
    write_vgg(tmp_path / "data/lpips/vgg16_features.pth")
    for record in read_records(measure(*words) / "records.jsonl"):
        assert not record.reasons
        assert record.metrics["lpips_vgg"] > 0
        assert record.metrics["lpips_vgg_raw"] > 0
        assert record.metrics["lpips_vgg"] != record.metrics["lpips_vgg_raw"]
