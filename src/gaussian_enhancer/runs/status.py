"""What became of a run, as marks in its folder tell: who works on it, why it failed, whether it is done.

``running`` names the process that works on the run; a process that was killed leaves it behind, and is then no longer
there. ``failed`` holds the error. Both vanish when the run is finished.
"""

import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text

RUNNING, FAILED, DONE = "running", "failed", "done"

Name = Literal["not started", "running", "stopped", "failed", "done"]
NAMES: tuple[Name, ...] = ("not started", "running", "stopped", "failed", "done")

_opened: ContextVar[list[Path] | None] = ContextVar("_opened", default=None)


@dataclass(frozen=True)
class State:
    """What became of a run.

    Args:
        name: "stopped" is a run that was begun and that nobody works on: the same command goes on with it.
        detail: the error, or who works on it.
    """

    name: Name
    detail: str = ""


def state_of(folder: Path | None) -> State:
    """The state of the run in a folder; None, or a folder without a run, is not started.

    Raises:
        InputError: a mark cannot be read.
    """
    if folder is None or not (folder / "config.yaml").is_file():
        return State("not started")
    if (folder / DONE).is_file():
        return State("done")
    running = _read(folder / RUNNING)
    if running and running.get("host") != socket.gethostname():
        return State("running", f"on {running.get('host')}, which cannot be asked from here")
    if running and _alive(running):
        return State("running", f"process {running['pid']}")
    failed = _read(folder / FAILED)
    return State("failed", str(failed.get("error"))) if failed else State("stopped")


def begin(folder: Path) -> None:
    """Mark a run as being worked on by this process; what it failed with before is forgotten."""
    from psutil import Process

    (folder / FAILED).unlink(missing_ok=True)
    who = {"pid": os.getpid(), "created": Process().create_time(), "host": socket.gethostname(), "time": time.time()}
    _write(folder / RUNNING, who)
    opened = _opened.get()
    if opened is not None:
        opened.append(folder)


def end(folder: Path) -> None:
    """Take the marks away."""
    for mark in (RUNNING, FAILED):
        (folder / mark).unlink(missing_ok=True)


@contextmanager
def attempt() -> Iterator[None]:
    """Whatever run is begun inside and left unfinished is no longer running afterwards; an error is kept as its reason.

    A run that is stopped by the user is no failure.
    """
    folders: list[Path] = []
    token = _opened.set(folders)
    try:
        yield
    except Exception as error:
        for folder in _unfinished(folders):
            _write(folder / FAILED, {"error": f"{type(error).__name__}: {error}", "time": time.time()})
        raise
    finally:
        _opened.reset(token)
        for folder in _unfinished(folders):
            (folder / RUNNING).unlink(missing_ok=True)


def _unfinished(folders: list[Path]) -> list[Path]:
    return [folder for folder in folders if folder.is_dir() and not (folder / DONE).is_file()]


def _alive(who: dict[str, object]) -> bool:
    """Whether the very process that wrote a mark is there; another one may have got its number since."""
    import psutil

    try:
        created = psutil.Process(int(str(who["pid"]))).create_time()
    except (psutil.Error, ValueError, KeyError):
        return False
    return abs(created - float(str(who.get("created", 0)))) < 2


def _read(mark: Path) -> dict[str, object]:
    """The content of a mark; empty where there is none."""
    try:
        values = json.loads(mark.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise InputError(mark, f"is no mark of a run ({error})", "delete it") from error
    return values if isinstance(values, dict) else {}


def _write(mark: Path, values: dict[str, object]) -> None:
    write_text(mark, json.dumps(values) + "\n")
