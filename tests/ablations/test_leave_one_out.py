"""The study leave_one_out: best shares of a change, on views that a splat was fitted to and on others."""

import dataclasses
import shutil

import pytest
import torch

from ablations.scripts.leave_one_out import measured, run
from ablations.study.rows import RowFile
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.scene.renders import read_run
from support.job_config import QUIET, job_config


class Adds(Network):
    """Adds an image to the render."""

    def __init__(self, change: torch.Tensor) -> None:
        super().__init__()
        self.change = change

    def stages(self, views):
        return (views.render + self.change,)


def test_the_best_share_of_a_change_that_goes_too_far_is_below_one(plane_run):
    rendered = read_run(plane_run)
    view = rendered.targets[0]
    checks = (-1.0) ** (torch.arange(48)[:, None] + torch.arange(64))
    photo = 0.25 + 0.5 * view.read_photo()
    view = dataclasses.replace(view, read=lambda: photo - 0.02 * checks, read_photo=lambda: photo)
    for step, share in ((0.02, 1.0), (0.08, 0.25)):
        enhancer = SetEnhancer(Adds(step * checks), ReferenceConfig(), precision="float32", colour_clamping=0)
        enhancer.colour_completion = False
        found = measured(view, ReferencePool(rendered.references), enhancer)
        assert found["best_share"] == pytest.approx(share, abs=0.03)
        assert (found["gain"] > 0) is (share > 0.5)
    blind = dataclasses.replace(view, read_photo=None)
    with pytest.raises(InputError, match="has no photo"):
        measured(blind, ReferencePool(rendered.references), enhancer)


def test_both_sides_of_a_fit_have_rows_and_a_page(plane_run, tmp_path, capsys):
    fit = tmp_path / "banana-3dgs-0"
    shutil.copytree(plane_run, fit)
    (fit / "done").touch()
    records, page = tmp_path / "found.jsonl", tmp_path / "found.md"
    run(job_config("leave_one_out", f"runs=[{fit}]", f"records={records}", f"page={page}", "weights=lr_tiny", *QUIET))
    frame = RowFile(records, ("run", "side", "view")).read()
    rendered = read_run(fit)
    assert set(frame.view[frame.side == "held out"]) == {view.name for view in rendered.targets}
    assert set(frame.view[frame.side == "training"]) == {view.name for view in rendered.references}
    assert "| banana |" in page.read_text(encoding="utf-8")
    capsys.readouterr()
    run(job_config("leave_one_out", "runs=[]", f"records={records}", *QUIET))
    assert "banana" in capsys.readouterr().out
