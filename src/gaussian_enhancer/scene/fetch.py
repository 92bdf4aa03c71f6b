"""Resumable, checked, atomic download of one archive.

A download grows in ``FILE.part``; a later attempt asks for the rest (``Range``, with ``If-Range`` where the server
named a version). A server that ignores ``Range`` sends everything, and the file starts anew.
"""

import fcntl
import http.client
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import unwritable
from gaussian_enhancer.scene.checksum import check_archive
from gaussian_enhancer.scene.datasets import Archive
from gaussian_enhancer.scene.transfer import Advance, Transfer

BROKEN = (OSError, http.client.HTTPException)
"""What a connection that fails raises; urllib's, ssl's and the system's timeouts are all OSError."""


@dataclass(frozen=True)
class Patience:
    """Retry limits and time-outs of a download.

    Args:
        retries: attempts in a row that bring nothing.
        pause: seconds before the second attempt; doubled after each that brings nothing, up to a minute.
        timeout: seconds without an answer or without data.
    """

    retries: int = 5
    pause: int | float = 1.0
    timeout: int | float = 60.0


def fetch(
    archive: Archive, path: Path, *, page: str = "", patience: Patience | None = None, advance: Advance | None = None
) -> str:
    """Fetch an archive, check it and put it in its place.

    Args:
        archive: what to fetch.
        path: where to put it; nothing is there before it is complete and its checksum is right.
        page: where its authors publish it, for errors.
        patience: when to give up.
        advance: told about progress.

    Returns:
        The archive's SHA-256; it also stands beside it in ``FILE.sha256``, which later copies are checked against.

    Raises:
        InputError: the address is refused, sends another file, or breaks off too often; the disk is full; another
            process fetches the same file.
    """
    patience, report = patience or Patience(), advance or (lambda done, total: None)
    with _lock_part(path.with_name(f"{path.name}.part")) as part:
        transfer = Transfer(archive, path, part, page, patience.timeout, report)
        most, idle, reason = transfer.size, 0, ""
        while not transfer.complete:
            try:
                transfer.attempt()
                reason = "the connection was closed"
            except BROKEN as error:
                reason = str(error) or type(error).__name__
            idle = 0 if transfer.size > most else idle + 1
            most = max(most, transfer.size)
            if idle > patience.retries and not transfer.complete:
                received = f"broke off {idle} times in a row, {transfer.size} bytes are there ({reason})"
                raise InputError(archive.url, received, "start again later: it goes on from there")
            if not transfer.complete:
                time.sleep(min(60.0, patience.pause * 2**idle))
        temporary = Path(str(part.name))
        try:
            digest = check_archive(archive, temporary, path, transfer.md5)
        except InputError:
            transfer.discard()
            raise
        transfer.version.unlink(missing_ok=True)
        os.replace(temporary, path)
    return digest


@contextmanager
def _lock_part(part: Path) -> Iterator[FileIO]:
    """The file under way, for this process alone; unbuffered, so that what is counted is written."""
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        file = FileIO(part, "a")
    except OSError as error:
        raise unwritable(part, error) from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(part, "is being fetched by another process", "wait for it, or end it") from None
        yield file
