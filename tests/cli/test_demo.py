"""The job ``demo``: from a procedural scene to the page, and faster the second time."""

import json
import re
from pathlib import Path

import pytest
import torch

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.cli import demo
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.metrics.records import read_records
from gaussian_enhancer.network.sif import SIF
from support.job_config import job_config, run_job

SMALL = (
    "scene.views=9",
    "scene.height=48",
    "scene.width=64",
    "settings.steps=3",
    "scene.split.train_every=1",
    "settings.max_gaussians=400",
)


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    save_weights(tmp_path / "new.safetensors", SIF((8, 8), (1, 1)), ReferenceConfig(), {})
    return tmp_path / "new.safetensors"


def run_demo(tmp_path: Path, weights: Path) -> float | None:
    runs = (f"runs={tmp_path / 'runs'}", f"weights={weights}", "runtime.threads=1", "runtime.progress=false")
    few = ("+settings.start_gaussians=400", "+settings.init=points")
    return run_job(demo.run, job_config("demo", *SMALL, *few, *runs))


@pytest.mark.slow
def test_the_page_shows_what_was_measured_and_the_fit_is_found_again(tmp_path: Path, weights: Path, capsys) -> None:
    gain = run_demo(tmp_path, weights)
    assert gain == 0.0, "a network that was never trained returns the render"
    shown = capsys.readouterr()
    (page,) = (tmp_path / "runs" / "demo").glob("*/report.html")
    assert page.resolve().as_uri() in shown.err
    data_block = re.search(r'id="report-data">(.*?)</script>', page.read_text(encoding="utf-8"), re.S)
    assert data_block
    (records,) = (tmp_path / "runs" / "measure").glob("*/records.jsonl")
    expected = {(r.view, r.variant): r.metrics["psnr"] for r in read_records(records)}
    views = json.loads(data_block[1])["views"]
    assert len(views) == 2
    for view in views:
        assert view["raw"]["psnr"] == expected[view["name"], "raw"]
        assert view["milliseconds"] > 0
        assert view["name"] in shown.out

    (splat,) = (tmp_path / "runs" / "fit").glob("*/splat.ply")
    before = splat.stat().st_mtime_ns
    run_demo(tmp_path, weights)
    assert splat.stat().st_mtime_ns == before
    assert "done before" in capsys.readouterr().err
