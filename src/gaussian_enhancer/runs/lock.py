"""Locks: only one process at a time writes a folder or a file of records.

The lock is an operating-system lock on a file ``.lock`` in the folder, or on a file beside the records. It ends with
the process that holds it, however that process ends, and its file is removed when the work ends. If the user starts a
second process on the same folder, that process is refused. A job that needs runs of other jobs, and the jobs of a
sweep, wait instead.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from filelock import FileLock, Timeout

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import to_write_error

NAME = ".lock"
RECORDS = (".jsonl", ".json")
"""File extensions of records."""


_held: dict[Path, tuple[FileLock, tuple[Path, ...]]] = {}
"""Locks of this process by file, each with the folders that were created for it, innermost first; those that stay empty
are removed again."""
_acquired: ContextVar[list[Path] | None] = ContextVar("_acquired", default=None)
_waits: ContextVar[bool] = ContextVar("_waits", default=False)


def hold(path: Path) -> bool:
    """Acquire a lock; return True if this process did not hold it before.

    Args:
        path: the folder, which is created if it is missing, or the file of records to be written.

    Raises:
        InputError: another process holds the lock, or the folder cannot be written.
    """
    file = _file(path)
    if file in _held:
        return False
    try:
        created = tuple(folder for folder in file.parents if not folder.exists())
        lock = FileLock(file, thread_local=False)
        while not _try_acquire(lock, file.parent, path):
            pass
    except OSError as error:
        raise to_write_error(path, error) from error
    _held[file] = (lock, created)
    paths = _acquired.get()
    if paths is not None:
        paths.append(path)
    return True


def release(path: Path) -> None:
    """Release a lock if this process holds it, and remove its file.

    Args:
        path: the same path as for `hold`.
    """
    file = _file(path)
    if file not in _held:
        return
    lock, created = _held.pop(file)
    with suppress(PermissionError):  # on Windows, which removes no open file: there, the release removes it
        # Before the release: a waiting process then creates a new file of that name.
        file.unlink(missing_ok=True)
    lock.release()
    with suppress(OSError):
        for folder in created:
            folder.rmdir()


@contextmanager
def exclusive(path: Path, wait: bool = False) -> Iterator[None]:
    """Hold a lock during the context; a second process is refused or waits, whatever `wait_for_holders` says.

    Args:
        path: the same path as for `hold`.
        wait: whether a second process waits.

    Raises:
        InputError: another process holds the lock and ``wait`` is not set, or the folder cannot be written.
    """
    with wait_for_holders(wait):
        acquired = hold(path)
    try:
        yield
    finally:
        if acquired:
            release(path)


@contextmanager
def release_at_end() -> Iterator[None]:
    """Release all locks that are acquired inside the context."""
    paths: list[Path] = []
    token = _acquired.set(paths)
    try:
        yield
    finally:
        _acquired.reset(token)
        for path in paths:
            release(path)


@contextmanager
def wait_for_holders(wait: bool = True) -> Iterator[None]:
    """Inside the context, wait for locks that other processes hold, instead of refusing.

    Args:
        wait: whether to wait.
    """
    token = _waits.set(wait)
    try:
        yield
    finally:
        _waits.reset(token)


def _file(path: Path) -> Path:
    path = path.absolute()
    return path.with_name(f".{path.name}{NAME}") if path.suffix in RECORDS else path / NAME


def _try_acquire(lock: FileLock, folder: Path, path: Path) -> bool:
    """Acquire a lock; False if its holder wrote nothing and removed the folder in the meantime."""
    folder.mkdir(parents=True, exist_ok=True)
    with suppress(FileNotFoundError):
        try:
            lock.acquire(timeout=0)
        except Timeout:
            if not _waits.get():
                received = "is being written by another process"
                raise InputError(path, received, "wait until that job ends, or choose another output") from None
            print(f"gaussian-enhancer: {path}: waiting for another process that writes it", file=sys.stderr)
            lock.acquire()
        return True
    return False
