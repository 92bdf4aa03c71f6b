"""Locks of folders: a second process is refused, or waits; nothing of a lock is left behind."""

import multiprocessing
import signal
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_json
from gaussian_enhancer.runs import lock, status
from gaussian_enhancer.runs.run import open_run

CONTEXT = multiprocessing.get_context("fork")  # at once, where a new interpreter takes a while


def hold_folder(folder, line):
    """Hold a folder in another process until it is told to end."""
    with lock.exclusive(Path(folder)):
        line.send("held")
        line.recv()


@pytest.fixture
def holder(tmp_path):
    """Another process that holds ``tmp_path / "a"``, and the line on which it is told to end."""
    line, its_end = CONTEXT.Pipe()
    process = CONTEXT.Process(target=hold_folder, args=(str(tmp_path / "a"), its_end))
    process.start()
    assert line.recv() == "held"
    yield process, line
    if process.is_alive():
        line.send("end")
    process.join()


def run_of(folder, size=1):
    return OmegaConf.create({"runs": "", "output": str(folder), "runtime": {}, "size": size})


def refused(folder, results):
    """Open a run, write files, and let the user's mistake end the attempt at it."""
    with status.track_runs(discard=True):
        run = open_run(run_of(folder), "toy", "a")
        for name in results:
            (run.folder / name).write_bytes(b"half of it")
        raise InputError("photo", "is cut", "replace it")


def test_a_second_process_is_refused_and_touches_nothing(holder, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match="a: is being written by another process; wait until that job ends"):
        open_run(run_of(tmp_path / "a"), "toy", "a")
    assert sorted(tmp_path.rglob("*")) == before
    with lock.exclusive(tmp_path / "b"):
        pass  # another folder is free


def test_what_is_done_alone_is_refused_also_where_runs_are_waited_for(holder, tmp_path):
    with lock.wait_for_holders(), pytest.raises(InputError, match="another process"), lock.exclusive(tmp_path / "a"):
        pass


def test_a_killed_process_holds_nothing(holder, tmp_path):
    process, _ = holder
    process.kill()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    with lock.exclusive(tmp_path / "a"):
        assert (tmp_path / "a" / lock.NAME).is_file()


def test_a_job_that_needs_the_run_waits(holder, tmp_path, monkeypatch, capsys):
    _, line = holder
    acquire = lock.FileLock.acquire

    def ending(self, timeout=None, **options):
        if timeout is None:  # it waits now
            line.send("end")
        return acquire(self, timeout, **options)

    monkeypatch.setattr(lock.FileLock, "acquire", ending)
    with lock.wait_for_holders(), status.track_runs():
        open_run(run_of(tmp_path / "a"), "toy", "a").finish()
    assert "a: waiting for another process that writes it" in capsys.readouterr().err
    assert {path.name for path in (tmp_path / "a").iterdir()} == {"config.yaml", "done"}


def test_nothing_is_left_of_a_lock_but_what_was_written(tmp_path):
    with lock.exclusive(tmp_path / "new" / "folder"):
        assert (tmp_path / "new" / "folder" / lock.NAME).is_file()
    assert not list(tmp_path.iterdir())
    with lock.exclusive(tmp_path / "kept"):
        (tmp_path / "kept" / "result").write_text("")
    assert [path.name for path in tmp_path.rglob("*")] == ["kept", "result"]
    with lock.exclusive(tmp_path / "results.jsonl"):
        assert [path.name for path in tmp_path.glob(".*")] == [".results.jsonl.lock"]
    assert not list(tmp_path.glob(".*"))


def test_an_attempt_gives_its_locks_back_and_a_refused_run_leaves_nothing(tmp_path):
    with pytest.raises(InputError, match="photo"):
        refused(tmp_path / "a", ())
    assert not list(tmp_path.iterdir())


def test_a_full_disk_does_not_hide_the_error(tmp_path, monkeypatch):
    def full(path, *values, **options):
        if path.name == status.FAILED:
            raise InputError(path, "cannot be written: no space left", "make room")
        write_json(path, *values, **options)

    monkeypatch.setattr("gaussian_enhancer.runs.status.write_json", full)
    with pytest.raises(InputError, match="photo"):
        refused(tmp_path / "a", ("checkpoint.pt",))


def test_a_refused_run_keeps_its_results(tmp_path):
    with pytest.raises(InputError, match="photo"):
        refused(tmp_path / "a", ("checkpoint.pt",))
    assert {path.name for path in (tmp_path / "a").iterdir()} == {"config.yaml", "failed", "checkpoint.pt"}


def test_a_process_may_take_its_own_lock_again(tmp_path):
    with lock.exclusive(tmp_path):
        with lock.exclusive(tmp_path):
            pass
        assert (tmp_path / lock.NAME).is_file()


def test_a_lock_is_released_where_the_system_removes_no_open_file(tmp_path, monkeypatch):
    """As on Windows."""

    def refuse(path, missing_ok=False):
        raise PermissionError(13, "is being used by another process", str(path))

    with monkeypatch.context() as windows:
        windows.setattr(Path, "unlink", refuse)
        with lock.exclusive(tmp_path / "a"):
            pass
    assert lock.hold(tmp_path / "a")
    lock.release(tmp_path / "a")
