"""One process writes a folder, or a file of records, at a time.

The lock is the operating system's own, on a file ``lock`` in the folder, or on one beside the records. It ends with the
process that holds it, however that ends, and its file is removed when the work ends. A second process that the user
starts on the same folder is refused. A job that needs the runs of other jobs, and the jobs of a sweep, wait instead.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import unwritable

NAME = "lock"
RECORDS = (".jsonl", ".json")
"""Endings of files of records."""


@dataclass(frozen=True)
class _Held:
    """A lock that this process holds.

    Args:
        lock: the lock.
        created: folders that were made for the lock, innermost first; those that stay empty are removed again.
    """

    lock: FileLock
    created: tuple[Path, ...]


_held: dict[Path, _Held] = {}
_taken: ContextVar[list[Path] | None] = ContextVar("_taken", default=None)
_waits: ContextVar[bool] = ContextVar("_waits", default=False)


def hold(place: Path) -> bool:
    """Take a lock; whether it was not held by this process before.

    Args:
        place: the folder, which is made where it is missing, or the file of records that will be written.

    Raises:
        InputError: another process holds the lock, or the folder cannot be written.
    """
    file = _file(place)
    if file in _held:
        return False
    try:
        created = tuple(folder for folder in file.parents if not folder.exists())
        lock = FileLock(file, thread_local=False)
        while not _try_acquire(lock, file.parent, place):
            pass
    except OSError as error:
        raise unwritable(place, error) from error
    _held[file] = _Held(lock, created)
    locked = _taken.get()
    if locked is not None:
        locked.append(place)
    return True


def release(place: Path) -> None:
    """Give a lock back, where this process holds it, and remove its file.

    Args:
        place: as for `hold`.
    """
    lock = _held.pop(_file(place), None)
    if lock is None:
        return
    _file(place).unlink(missing_ok=True)  # while it is held: who waits for it takes a file of the same name anew
    lock.lock.release()
    with suppress(OSError):
        for folder in lock.created:
            folder.rmdir()


@contextmanager
def exclusive(place: Path) -> Iterator[None]:
    """Hold a lock; a second process is refused, also within `wait_for_holders`.

    Args:
        place: as for `hold`.

    Raises:
        InputError: another process holds the lock, or the folder cannot be written.
    """
    with wait_for_holders(False):
        new = hold(place)
    try:
        yield
    finally:
        if new:
            release(place)


@contextmanager
def release_at_end() -> Iterator[None]:
    """Give back all locks that are taken inside the context."""
    locked: list[Path] = []
    token = _taken.set(locked)
    try:
        yield
    finally:
        _taken.reset(token)
        for place in locked:
            release(place)


@contextmanager
def wait_for_holders(wait: bool = True) -> Iterator[None]:
    """Wait for locks that other processes hold, instead of refusing.

    Args:
        wait: whether to wait.
    """
    token = _waits.set(wait)
    try:
        yield
    finally:
        _waits.reset(token)


def _file(place: Path) -> Path:
    place = place.absolute()
    return place.with_name(f".{place.name}.{NAME}") if place.suffix in RECORDS else place / NAME


def _try_acquire(lock: FileLock, folder: Path, place: Path) -> bool:
    """Take a lock; False where its holder wrote nothing and removed the folder meanwhile."""
    folder.mkdir(parents=True, exist_ok=True)
    with suppress(FileNotFoundError):
        try:
            lock.acquire(timeout=0)
        except Timeout:
            if not _waits.get():
                received = "is being written by another process"
                raise InputError(place, received, "wait until that one ends, or choose another output") from None
            print(f"gaussian-enhancer: {place}: waiting for another process that writes it", file=sys.stderr)
            lock.acquire()
        return True
    return False
