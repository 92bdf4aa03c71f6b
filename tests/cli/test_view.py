"""The job view: what it refuses, what it loads, and how it ends."""

import os
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
import torch

from gaussian_enhancer.cli import main as cli
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.viewer.source import open_session
from support.job_config import job_config
from support.synthetic_runs import plane_camera

pytest.importorskip("viser", reason="viser is in the dependency group `test`")
QUIET = ("runtime.progress=false", "runtime.threads=1", "runtime.device=cpu", "weights=lr_tiny")
UNUSED = ("kornia", "lightning", "lpips", "matplotlib", "tensorboard", "torchmetrics", "torchvision", "wandb")
"""Packages of trainings and of measurements."""


def configured(*words: str):
    return job_config("view", *words, *QUIET)


def refused(capsys, tmp_path: Path, *words: str) -> str:
    """The line of a command that must be refused and leave nothing behind."""
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(SystemExit) as stop:
        cli.main(["view", *words, *QUIET])
    lines = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
    assert stop.value.code == 2
    assert len(lines) == 1, lines
    assert sorted(tmp_path.rglob("*")) == before
    return lines[0]


def test_a_port_in_use_is_one_line(sheet_run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen(1)
        port = listener.getsockname()[1]
        stderr = refused(capsys, tmp_path, f"run={sheet_run}", f"port={port}")
    assert f"port={port}: cannot be listened at" in stderr
    assert "give another port, or port=0" in stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["port=0"], "was given nothing to render"),
        (["gaussians=notes.txt", "scene=capture", "scene.path=."], "notes.txt"),
        (["gaussians=broken.ply", "scene=transforms", "scene.path=none"], "none"),
        (["run=.", "port=0"], "test"),
        (["run={sheet_run}", "show=normal"], "show: is 'normal'; choose enhanced"),
        (["run={sheet_run}", "width=10"], "width: is 10; give a number of at least 64"),
        (["run={sheet_run}", "port=-1"], "port: is -1"),
        (["run={sheet_run}", "port=0", "output=notes.txt"], "notes.txt: cannot be written: it is a file"),
    ],
)
def test_bad_input_is_one_line(sheet_run, tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    Path("notes.txt").write_text("no splat")
    Path("broken.ply").write_text("ply\n")
    assert message in refused(capsys, tmp_path, *(word.format(sheet_run=sheet_run) for word in words))


def test_without_viser_it_is_one_line(sheet_run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "viser", None)
    assert 'pip install "gaussian-enhancer[viewer]"' in refused(capsys, tmp_path, f"run={sheet_run}")


def one_photo(sheet_run: Path, held_out: bool) -> Scene:
    view = read_run(sheet_run).references[0]
    photo = Photo(view.name, plane_camera(1, 48, 64), view.read_photo)  # type: ignore[arg-type]
    return Scene("one", (photo,), () if held_out else (0,), (0,) if held_out else ())


def test_one_photo_is_enough_to_look_at_and_none_is_refused(sheet_run, monkeypatch):
    cfg = configured(f"gaussians={sheet_run / 'splat.ply'}", "scene=capture", "scene.path=x")
    monkeypatch.setattr("gaussian_enhancer.runs.splat_source.build", lambda _: one_photo(sheet_run, False))
    session = open_session(cfg, torch.device("cpu"), print)
    view = session.draw(session.initial_choice, session.cameras[0])
    assert view is not None
    assert view.references == (session.stage(session.initial_choice).pool.views[0].name,)
    monkeypatch.setattr("gaussian_enhancer.runs.splat_source.build", lambda _: one_photo(sheet_run, True))
    with pytest.raises(InputError, match="one: has no photo to refer to"):
        open_session(cfg, torch.device("cpu"), print)


def test_it_serves_a_page_until_ctrl_c_and_loads_no_package_of_trainings(sheet_run, tmp_path):
    program = (
        "import sys, atexit; atexit.register(lambda: print('loaded', *sys.modules));"
        "from gaussian_enhancer.cli.main import main; main(sys.argv[1:])"
    )
    words = ["view", f"run={sheet_run}", "port=0", *QUIET]
    running = subprocess.Popen(
        [sys.executable, "-c", program, *words],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "COLUMNS": "200"},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    try:
        assert running.stderr is not None
        first = running.stderr.readline()
        address = first.split()[0]
        assert address.startswith("http://127.0.0.1:"), first
        with urllib.request.urlopen(address, timeout=60) as answer:
            assert b"viser" in answer.read().lower()
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=120)
    finally:
        running.kill()
    assert running.returncode == 130
    assert err.splitlines() == ["stopped; runs/view/plane holds 0 saved views and paths"]
    loaded = next(line for line in out.splitlines() if line.startswith("loaded ")).split()
    assert "viser" in loaded
    assert not [name for name in loaded if name.split(".")[0] in UNUSED]
    assert not list(tmp_path.iterdir())
