"""The job view: what it refuses, what it loads, and how it ends."""

import os
import shutil
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
from gaussian_enhancer.splat.io.ply import write_ply
from gaussian_enhancer.viewer.source import open_session
from support import paths
from support.synthetic_runs import coloured_sheet, plane_camera

pytest.importorskip("viser", reason="viser is in the dependency group `test`")
QUIET = ("runtime.progress=false", "runtime.threads=1", "runtime.device=cpu", "weights=lr_tiny")
UNUSED = ("kornia", "lightning", "lpips", "matplotlib", "tensorboard", "torchmetrics", "torchvision", "wandb")
"""Packages of trainings and of measurements."""


@pytest.fixture(scope="module")
def fitted(plane_run, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("fitted") / "plane"
    shutil.copytree(plane_run, folder)
    write_ply(folder / "splat.ply", coloured_sheet(24))
    return folder


def configured(*words: str):
    from hydra import compose, initialize_config_dir

    with initialize_config_dir(paths.CONF, version_base="1.3"):
        return compose("view", [*words, *QUIET])


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


def test_a_port_in_use_is_one_line(fitted, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen(1)
        port = other.getsockname()[1]
        told = refused(capsys, tmp_path, f"run={fitted}", f"port={port}")
    assert f"port={port}: cannot be listened at" in told
    assert "give another port, or port=0" in told


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["port=0"], "was given nothing to render"),
        (["gaussians=notes.txt", "scene=capture", "scene.path=."], "notes.txt"),
        (["gaussians=broken.ply", "scene=transforms", "scene.path=none"], "none"),
        (["run=.", "port=0"], "test"),
        (["run={fitted}", "show=normal"], "show: is 'normal'; choose enhanced"),
        (["run={fitted}", "width=10"], "width: is 10; give a number of at least 64"),
        (["run={fitted}", "port=-1"], "port: is -1"),
        (["run={fitted}", "port=0", "output=notes.txt"], "notes.txt: cannot be written: it is a file"),
    ],
)
def test_bad_input_is_one_line(fitted, tmp_path, monkeypatch, capsys, words, told):
    monkeypatch.chdir(tmp_path)
    Path("notes.txt").write_text("no splat")
    Path("broken.ply").write_text("ply\n")
    assert told in refused(capsys, tmp_path, *(word.format(fitted=fitted) for word in words))


def test_without_viser_it_is_one_line(fitted, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "viser", None)
    assert 'pip install "gaussian-enhancer[viewer]"' in refused(capsys, tmp_path, f"run={fitted}")


def one_photo(fitted: Path, held_out: bool) -> Scene:
    view = read_run(fitted).references[0]
    photo = Photo(view.name, plane_camera(1, 48, 64), view.read_photo)  # type: ignore[arg-type]
    return Scene("one", (photo,), () if held_out else (0,), (0,) if held_out else ())


def test_one_photo_is_enough_to_look_at_and_none_is_refused(fitted, monkeypatch):
    cfg = configured(f"gaussians={fitted / 'splat.ply'}", "scene=capture", "scene.path=x")
    monkeypatch.setattr("gaussian_enhancer.runs.splat_source.build", lambda _: one_photo(fitted, False))
    session = open_session(cfg, torch.device("cpu"))
    view = session.draw(session.first, session.cameras[0])
    assert view is not None
    assert view.references == (session.stage(session.first).pool.views[0].name,)
    monkeypatch.setattr("gaussian_enhancer.runs.splat_source.build", lambda _: one_photo(fitted, True))
    with pytest.raises(InputError, match="one: has no photo to refer to"):
        open_session(cfg, torch.device("cpu"))


def test_it_serves_a_page_until_ctrl_c_and_loads_no_package_of_trainings(fitted, tmp_path):
    program = (
        "import sys, atexit; atexit.register(lambda: print('loaded', *sys.modules));"
        "from gaussian_enhancer.cli.main import main; main(sys.argv[1:])"
    )
    words = ["view", f"run={fitted}", "port=0", *QUIET]
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
