"""The status of a run, stored as files in its folder: ``running``, ``failed`` and ``done``.

``running`` names the process that works on the run. A killed process leaves this file behind. The run then counts as
stopped, since the process no longer exists. ``failed`` holds the error. A finished run has neither of the two.
"""

import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_json
from gaussian_enhancer.runs import lock

RUNNING, FAILED, DONE = "running", "failed", "done"
BEFORE_RESULTS = frozenset({"config.yaml", RUNNING, FAILED, lock.NAME})
"""Files of a run's folder that are not results."""

StateName = Literal["not started", "running", "stopped", "failed", "done"]
NAMES: tuple[StateName, ...] = ("not started", "running", "stopped", "failed", "done")

_started_folders: ContextVar[list[Path] | None] = ContextVar("_started_folders", default=None)
"""Folders of the runs that were started inside the innermost `track_runs`."""


@dataclass(frozen=True)
class State:
    """The status of a run.

    Args:
        name: "stopped" means that the run was started, but no process works on it; the same command resumes it.
        detail: the error, or the process that works on the run.
    """

    name: StateName
    detail: str = ""


def state_of(folder: Path | None) -> State:
    """The status of the run in a folder. If the folder is None or holds no run, the status is "not started".

    Raises:
        InputError: a status file cannot be read.
    """
    if folder is None or not (folder / "config.yaml").is_file():
        return State("not started")
    if (folder / DONE).is_file():
        return State("done")
    running = _read(folder / RUNNING)
    if running and running.get("host") != socket.gethostname():
        return State("running", f"on {running.get('host')}, another machine; whether it still runs is unknown")
    if running and _writer_is_alive(running):
        return State("running", f"process {running['pid']}")
    failed = _read(folder / FAILED)
    return State("failed", str(failed.get("error"))) if failed else State("stopped")


def mark_running(folder: Path) -> None:
    """Mark a run as running in this process and remove an earlier error."""
    from psutil import Process

    (folder / FAILED).unlink(missing_ok=True)
    process = {
        "pid": os.getpid(),
        "created": Process().create_time(),
        "host": socket.gethostname(),
        "time": time.time(),
    }
    write_json(folder / RUNNING, process)
    started_folders = _started_folders.get()
    if started_folders is not None:
        started_folders.append(folder)


def remove_marks(folder: Path) -> None:
    """Remove the files ``running`` and ``failed``."""
    for status_file in (RUNNING, FAILED):
        (folder / status_file).unlink(missing_ok=True)


@contextmanager
def track_runs(discard: bool = False) -> Iterator[None]:
    """Update the status of all runs that are started but not finished inside the context, and unlock their folders.

    An exception is written to ``failed`` as the reason. A run that the user interrupts has the status stopped.

    Args:
        discard: remove runs that were refused before they wrote a result, instead of marking them as failed.
    """
    folders: list[Path] = []
    token = _started_folders.set(folders)
    with lock.release_at_end():
        try:
            yield
        except Exception as error:
            for folder in _unfinished(folders):
                if discard and isinstance(error, InputError | OSError) and holds_no_result(folder):
                    _discard_marks(folder)
                    continue
                with suppress(InputError):  # a full disk must not hide the error
                    write_json(folder / FAILED, {"error": f"{type(error).__name__}: {error}", "time": time.time()})
            raise
        finally:
            _started_folders.reset(token)
            for folder in _unfinished(folders):
                (folder / RUNNING).unlink(missing_ok=True)


def holds_no_result(folder: Path) -> bool:
    """Whether a folder holds only a run's configuration and status files."""
    return {path.name for path in folder.iterdir()} <= BEFORE_RESULTS


def _discard_marks(folder: Path) -> None:
    """Remove a run's configuration and status files. A folder created for the run is removed with its lock."""
    for name in BEFORE_RESULTS - {lock.NAME}:
        (folder / name).unlink(missing_ok=True)


def _unfinished(folders: list[Path]) -> list[Path]:
    return [folder for folder in folders if folder.is_dir() and not (folder / DONE).is_file()]


def _writer_is_alive(process: dict[str, object]) -> bool:
    """Whether the process that wrote ``running`` still exists; its number may have been reused by another process."""
    import psutil

    try:
        created = psutil.Process(int(str(process["pid"]))).create_time()
    except (psutil.Error, ValueError, KeyError):
        return False
    return abs(created - float(str(process.get("created", 0)))) < 2


def _read(mark: Path) -> dict[str, object]:
    """The content of a status file; empty where there is none."""
    try:
        values = json.loads(mark.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise InputError(mark, f"is not a status file ({error})", "delete it") from error
    return values if isinstance(values, dict) else {}
