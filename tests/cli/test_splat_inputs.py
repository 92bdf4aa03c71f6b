"""What the jobs distil and video refuse: one line, and nothing is written."""

import importlib
from collections.abc import Callable
from pathlib import Path

import pytest

from gaussian_enhancer.errors import InputError
from support.job_config import QUIET, job_config

JOBS = {"distil": ("settings.steps=40", "settings.views=3", "settings.fade=1"), "video": ("frames=5",)}
BOTH = [
    (["gaussians=a.ply"], "was given run and gaussians"),
    (["run=null", "gaussians=a.ply"], "comes without its capture; add scene=capture"),
    (["weights=none_such"], "is neither a file nor a shipped name"),
]
OWN = {
    "distil": [
        (["run=null"], "distil: was given no splat; give one of run="),
        (["settings.share=2"], r"settings\.share"),
        (["settings.steps=1"], r"settings\.rounds: is 2 for 1 steps"),
        (["evidence.views=0"], r"evidence|prune\.views"),
        (["method=4dgs"], "method: is '4dgs'"),
        (["format=sog"], "format: is 'sog'; choose ply, compressed, spz"),
        (["method=2dgs"], "has 3 scale axes"),
        (["strength=3"], "strength: is 3"),
        (["max_references=0"], "max_references: is 0"),
        (["weights=sr_tiny"], "sr_tiny: enlarge what they enhance"),
    ],
    "video": [
        (["run=null"], "video: was given nothing to render; give one of run="),
        (["format=avi"], "format: is 'avi'; choose mp4, webm, frames"),
        (["layout=beside"], "layout: is 'beside'"),
        (["output=a.mkv"], r"a\.mkv: does not end in \.mp4"),
        (["output=a.webm", "format=mp4"], r"a\.webm: does not end in \.mp4"),
        (["path=orbti"], "orbti: does not exist; choose interpolate, orbit, spiral"),
        (["path=orbit"], "optical axes do not meet"),
        (["path=spiral", "radius=30"], "path=spiral: leaves the capture"),
        (["frames=1"], "frames"),
        (["fps=0"], "fps: is 0"),
        (["quality=99"], "quality: is 99"),
        (["height=1"], "height: is 1; give pixels"),
        (["temporal_smoothing=1"], "temporal_smoothing: is 1"),
    ],
}


@pytest.fixture
def started(bright, tmp_path, monkeypatch) -> Callable[..., None]:
    """Run a job in an empty folder, where whatever is left behind can be seen."""
    monkeypatch.chdir(tmp_path)

    def start(job: str, run: Path, *words: str) -> None:
        if job == "video":
            pytest.importorskip("av", reason="PyAV is in the dependency group `test`")
        usual = f"run={run}", f"weights={bright}", "runs=runs", *JOBS[job], *QUIET
        importlib.import_module(f"gaussian_enhancer.cli.{job}").run(job_config(job, *usual, *words))

    return start


@pytest.mark.parametrize(("job", "words", "message"), [(job, *case) for job in JOBS for case in (*BOTH, *OWN[job])])
def test_bad_input_is_one_line_and_nothing_is_written(sheet_run, started, tmp_path, job, words, message):
    with pytest.raises(InputError, match=message):
        started(job, sheet_run, *words)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("job", JOBS)
def test_a_run_without_its_splat_is_refused(plane_run, started, tmp_path, job):
    with pytest.raises(InputError, match=r"holds neither splat\.ply nor point_cloud"):
        started(job, plane_run)
    assert not list(tmp_path.iterdir())
