"""Resumable, atomic download of one archive with verified checksums.

A download is written to ``FILE.part``. A later attempt requests the missing bytes (``Range``, with ``If-Range`` where
the server stated an ETag). If the server ignores ``Range`` and sends the whole file, the download restarts.
"""

import http.client
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import FileIO
from pathlib import Path

from filelock import FileLock, Timeout

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import to_write_error
from gaussian_enhancer.scene.checksum import check_archive
from gaussian_enhancer.scene.datasets import Archive
from gaussian_enhancer.scene.transfer import Advance, Transfer

CONNECTION_ERRORS = (OSError, http.client.HTTPException)
"""Exceptions of a failed connection; the timeouts of urllib, ssl and the system are all OSError."""


def fetch(
    archive: Archive,
    path: Path,
    *,
    page: str = "",
    advance: Advance | None = None,
    retries: int = 5,
    pause: int | float = 1.0,
    timeout: int | float = 60.0,
) -> str:
    """Download an archive, verify it and move it to its final path.

    Args:
        archive: description of the archive.
        path: final path; it is not created before the file is complete and its checksums are verified.
        page: address of its authors' page, for errors.
        advance: progress callback.
        retries: maximum number of consecutive attempts without new data; one more is an error.
        pause: seconds before the next attempt, doubled for each consecutive attempt without new data, up to a minute.
        timeout: seconds without a response or without data.

    Returns:
        The archive's SHA-256. It is also written to ``FILE.sha256`` beside the archive, and later copies are checked
        against it.

    Raises:
        InputError: the server refuses the request or sends another file, the connection breaks too often, the disk is
            full, or another process is downloading the same file.
    """
    report = advance or (lambda done, total: None)
    with _lock_part(path.with_name(f"{path.name}.part")) as partial_file:
        transfer = Transfer(archive, path, partial_file, page, timeout, report)
        most_bytes, idle_attempts, reason = transfer.size, 0, ""
        while not transfer.complete:
            try:
                transfer.attempt()
                reason = "the connection was closed"
            except CONNECTION_ERRORS as error:
                reason = str(error) or type(error).__name__
            idle_attempts = 0 if transfer.size > most_bytes else idle_attempts + 1
            most_bytes = max(most_bytes, transfer.size)
            if idle_attempts > retries and not transfer.complete:
                received = f"broke off {idle_attempts} times in a row, {transfer.size} bytes are there ({reason})"
                raise InputError(archive.url, received, "run the same command later; it resumes")
            if not transfer.complete:
                time.sleep(min(60.0, pause * 2**idle_attempts))
        temporary = Path(str(partial_file.name))
        partial_file.close()  # Windows neither moves nor removes an open file
        try:
            digest = check_archive(archive, temporary, path, transfer.md5)
        except InputError:
            transfer.discard()
            raise
        transfer.version_file.unlink(missing_ok=True)
        os.replace(temporary, path)
    return digest


@contextmanager
def _lock_part(part: Path) -> Iterator[FileIO]:
    """Open the partial file under an exclusive lock; unbuffered, so that all counted bytes are written.

    The lock is held on ``FILE.part.lock``, since Windows would lock the bytes of the partial file itself.
    """
    lock = FileLock(f"{part}.lock")
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout:
        raise InputError(part, "is being fetched by another process", "wait until it ends, or stop it") from None
    except OSError as error:
        raise to_write_error(part, error) from error
    try:
        with _open_part(part) as file:
            yield file
    finally:
        with suppress(OSError):  # before the release, so that nobody acquires a removed file; Windows removes it itself
            os.unlink(lock.lock_file)
        lock.release()


def _open_part(part: Path) -> FileIO:
    try:
        return FileIO(part, "a")
    except OSError as error:
        raise to_write_error(part, error) from error
