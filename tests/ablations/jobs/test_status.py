"""Marks of runs and the job ``status``: what became of a run whose process ended in whatever way."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from ablations.jobs import status as status_job
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs import status
from gaussian_enhancer.runs.run import Run, open_run


def opened(folder: Path, label: str = "a", **values: object) -> Run:
    return open_run(OmegaConf.create({"runs": str(folder), "label": label, **values}), "toy", label)


def interrupted(folder: Path, label: str, error: BaseException) -> None:
    """Open a run, and let an error end the attempt at it."""
    with status.track_runs():
        opened(folder, label)
        raise error


def state(folder: Path, label: str) -> status.State:
    (found,) = folder.glob(f"toy/{label}-*")
    return status.state_of(found)


def test_a_run_is_running_until_it_is_finished(tmp_path) -> None:
    assert status.state_of(None).name == "not started"
    run = opened(tmp_path)
    assert status.state_of(run.folder) == status.State("running", f"process {os.getpid()}")
    run.finish()
    assert status.state_of(run.folder).name == "done"
    assert {path.name for path in run.folder.iterdir()} == {"config.yaml", "done"}
    opened(tmp_path)
    assert status.state_of(run.folder).name == "done"


def test_an_error_is_kept_until_the_run_is_opened_again(tmp_path) -> None:
    with pytest.raises(InputError):
        interrupted(tmp_path, "a", InputError("disk", "is full", "free some space"))
    assert state(tmp_path, "a") == status.State("failed", "InputError: disk: is full; free some space")
    run = opened(tmp_path)
    assert status.state_of(run.folder).name == "running"
    run.finish()
    assert status.state_of(run.folder).name == "done"


def test_a_run_stopped_by_the_user_or_left_unfinished_is_no_failure(tmp_path) -> None:
    with pytest.raises(KeyboardInterrupt):
        interrupted(tmp_path, "one", KeyboardInterrupt())
    with status.track_runs():
        opened(tmp_path, "two")
    assert [state(tmp_path, label).name for label in ("one", "two")] == ["stopped", "stopped"]


def test_an_inner_attempt_marks_its_own_runs_alone(tmp_path) -> None:
    with status.track_runs():
        outer = opened(tmp_path, "outer")
        with pytest.raises(ValueError, match="inner"):
            interrupted(tmp_path, "inner", ValueError("inner"))
        assert state(tmp_path, "inner") == status.State("failed", "ValueError: inner")
        assert status.state_of(outer.folder).name == "running"


def test_a_killed_process_leaves_a_stopped_run(tmp_path) -> None:
    code = (
        "import os, signal, sys; from omegaconf import OmegaConf; from gaussian_enhancer.runs.run import open_run;"
        "open_run(OmegaConf.create({'runs': sys.argv[1]}), 'toy', 'a'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    ended = subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    assert ended.returncode == -signal.SIGKILL
    (folder,) = (tmp_path / "toy").iterdir()
    assert (folder / "running").is_file()
    assert status.state_of(folder).name == "stopped"


def test_another_process_with_the_same_number_is_not_taken_for_it(tmp_path) -> None:
    run = opened(tmp_path)
    mark = run.folder / "running"
    mark.write_text(mark.read_text().replace('"created": ', '"created": 1'))
    assert status.state_of(run.folder).name == "stopped"


def test_a_run_on_another_host_cannot_be_asked(tmp_path) -> None:
    run = opened(tmp_path)
    mark = run.folder / "running"
    mark.write_text('{"pid": 1, "host": "elsewhere"}')
    assert status.state_of(run.folder) == status.State(
        "running", "on elsewhere, another machine; whether it still runs is unknown"
    )


def test_a_damaged_mark_is_named(tmp_path) -> None:
    run = opened(tmp_path)
    (run.folder / "running").write_text("{")
    with pytest.raises(InputError, match="running: is not a status file"):
        status.state_of(run.folder)


def test_status_lists_runs_with_their_states(tmp_path, capsys) -> None:
    opened(tmp_path, "done").finish()
    opened(tmp_path, "running")
    with pytest.raises(ValueError, match="broken"):
        interrupted(tmp_path, "failed", ValueError("broken"))
    cfg = OmegaConf.create({"runs": str(tmp_path), "table": None, "states": None})
    status_job.run(cfg)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[:-1]] == ["done", "failed", "running"]
    assert lines[1].endswith(": ValueError: broken")
    assert lines[-1] == "3 runs: 0 not started, 1 running, 0 stopped, 1 failed, 1 done"
    status_job.run(OmegaConf.merge(cfg, {"states": ["failed"]}))
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_unknown_states_are_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="names 'dead'"):
        status_job.run(OmegaConf.create({"runs": str(tmp_path), "table": None, "states": ["dead"]}))
