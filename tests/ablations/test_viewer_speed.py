"""What the measurement of the viewer reads is what its page states."""

import json

import pytest
import torch
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf
from PIL import Image

from ablations.benchmarks.viewer_speed import parse_status, quote, words_of
from gaussian_enhancer.viewer.controls import status
from gaussian_enhancer.viewer.modes import Mode
from gaussian_enhancer.viewer.stage import StageView, Times


def test_the_pages_line_is_read():
    image, plane = torch.zeros(3, 8, 20), torch.ones(1, 8, 20)
    for enhanced, times, total in ((image, Times(10.0, 20.0, 30.4), 60), (None, Times(10.0), 10)):
        view = StageView(image, plane, plane, enhanced, None, (), times)
        told = status(12, image, view, Mode("wipe")).replace("**", "")
        assert parse_status(f"gaussian-enhancer {told} Show mode") == (total, 20, 8, 12)
    assert parse_status("Waiting for the first picture.") is None


def test_the_viewer_gets_the_options_of_the_measurement():
    given = {"runtime": {"device": "cpu", "threads": 1}, "overrides": ["plan=full"]}
    assert words_of(OmegaConf.create(given)) == ["runtime.device=cpu", "runtime.threads=1", "plan=full"]
    usual = {"runtime": {"device": "auto", "threads": None}, "overrides": []}
    assert words_of(OmegaConf.create(usual)) == []


@pytest.mark.parametrize("path", ["runs/fit/a", "my runs/a=b, c", "it's {1}"])
def test_a_run_of_any_name_is_one_value(path):
    (override,) = OverridesParser.create().parse_overrides([f"run={quote(path)}"])
    assert override.value() == path


@pytest.mark.browser
@pytest.mark.slow
def test_pictures_are_counted_and_recorded_and_the_page_is_pictured(sheet_run, tmp_path, job, browser, capsys):
    pytest.importorskip("viser", reason="viser is in the dependency group `test`")
    words = (f"run={sheet_run}", "show=render", "width=128", "runtime.device=cpu")
    job("viewer_speed", *words, "seconds=2", "overrides=['precision=float32']", f"records={tmp_path}/found.json")
    found = json.loads((tmp_path / "found.json").read_text())
    shown = f"| plane | render | 128 | {found['pictures_a_second']:.2f} |"
    assert capsys.readouterr().out.splitlines()[2].startswith(shown)
    assert (found["run"], found["show"]) == ("plane", "render")
    assert found["options"] == "runtime.device=cpu runtime.threads=1 precision=float32"
    assert found["pictures"] > 0
    job("viewer_speed", *words, f"picture={tmp_path}/made/page.jpg")
    assert [path.name for path in (tmp_path / "made").iterdir()] == ["page.jpg"]
    assert Image.open(tmp_path / "made/page.jpg").format == "JPEG"
