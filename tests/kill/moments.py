"""Disturbances of a process at the moment of a write: a signal, a stop, or a disk without room.

Writes are counted by Python's audit events: files opened for writing, moved and removed, and folders made, within the
folder that the process began in. So a moment is the same in every run, however fast the machine is.
"""

import os
import resource
import signal
import sys
import threading
from pathlib import Path
from typing import Any

WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
FULL = "disk full"


def watch(log: Path, at: int | None = None, action: str = "") -> None:
    """Write every write of this process, from now on, as a line to a log, and disturb the one with number ``at``.

    Args:
        log: a file outside the folder; a line is the event and the path within the folder.
        at: number of the write, from 0, before which to act; None: do not.
        action: name of a signal that the process sends itself, or FULL: no file grows any more.
    """
    folder = Path.cwd().resolve()
    lines = open(log, "a", buffering=1, encoding="utf-8")  # noqa: SIM115
    lock, count = threading.RLock(), 0

    def seen(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal count
        if action == FULL and at is not None and count > at:  # the log has no room either
            return
        if event == "fcntl.flock":
            lines.write("flock\n")
            return
        path = _written(event, arguments, folder)
        if path is None:
            return
        with lock:
            number, count = count, count + 1
        lines.write(f"{event} {path}\n")
        if number == at:
            _act(action)

    sys.addaudithook(seen)


def _written(event: str, arguments: tuple[Any, ...], folder: Path) -> str | None:
    """What an event writes within a folder, None if nothing."""
    if event == "open":
        path, _, flags = arguments
        if not isinstance(path, str | bytes | os.PathLike) or not (flags & WRITING):
            return None
    elif event == "os.rename":
        path = arguments[1]
    elif event in ("os.remove", "os.mkdir"):
        path = arguments[0]
    else:
        return None
    whole = os.path.join(folder, os.fsdecode(path))
    return os.path.relpath(whole, folder) if whole.startswith(f"{folder}{os.sep}") else None


def _act(action: str) -> None:
    if action == FULL:
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
    else:
        os.kill(os.getpid(), signal.Signals[action])
