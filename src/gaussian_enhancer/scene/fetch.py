"""Fetching one archive over HTTP: resumed where it broke off, checked, whole at its name or not there.

A download grows in ``FILE.part``; a later attempt asks for the rest (``Range``, with ``If-Range`` where the server
named a version). A server that ignores ``Range`` sends everything, and the file starts anew.
"""

import fcntl
import http.client
import os
import re
import shutil
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import unwritable
from gaussian_enhancer.scene.checksum import check_archive, served_md5
from gaussian_enhancer.scene.datasets import Archive

BLOCK = 1 << 20
"""Bytes that are read at a time."""
PASSING = (408, 425, 429, 500, 502, 503, 504)
"""Answers that may be others a moment later."""
BROKEN = (urllib.error.URLError, http.client.HTTPException, TimeoutError, ConnectionError)
Advance = Callable[[int, int | None], None]
"""Told how many bytes are there, and of how many."""


@dataclass(frozen=True)
class Patience:
    """When to give up.

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
    patience, told = patience or Patience(), advance or (lambda done, total: None)
    with _locked(path.with_name(f"{path.name}.part")) as part:
        transfer = _Transfer(archive, path, part, page, patience, told)
        most, idle, reason = transfer.size, 0, ""
        while not transfer.complete:
            try:
                transfer.attempt()
                reason = "the connection was closed"
            except BROKEN as error:
                reason = str(error) or type(error).__name__
            idle = 0 if transfer.size > most else idle + 1
            most = max(most, transfer.size)
            if idle > patience.retries:
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


class _Transfer:
    """One file under way: what is there, what the server said of it."""

    def __init__(
        self, archive: Archive, path: Path, part: FileIO, page: str, patience: Patience, advance: Advance
    ) -> None:
        self.archive, self.path, self.part, self.page = archive, path, part, page
        self.timeout, self.advance = patience.timeout, advance
        self.version = Path(f"{part.name}.etag")
        self.md5: str | None = None
        self.size = part.seek(0, os.SEEK_END)
        self.complete = False

    def attempt(self) -> None:
        """Ask for what is missing and write it; leaves what arrived where the connection breaks."""
        try:
            response = urllib.request.urlopen(self._request(), timeout=self.timeout)
        except urllib.error.HTTPError as error:
            self._refused(error)
            return
        with response:
            total = self._accepted(response)
            self._room(total)
            self.advance(self.size, total)
            while block := response.read(BLOCK):
                self._write(block)
                self.advance(self.size, total)
        expected = total if total is not None else self.archive.bytes
        self.complete = expected is None or self.size >= expected

    def discard(self) -> None:
        """Forget what is there."""
        self._restart()
        Path(str(self.part.name)).unlink(missing_ok=True)
        self.version.unlink(missing_ok=True)

    def _request(self) -> urllib.request.Request:
        headers = {"User-Agent": "gaussian-enhancer", "Accept-Encoding": "identity"}
        if self.size:
            headers["Range"] = f"bytes={self.size}-"
            if self.version.is_file():
                headers["If-Range"] = self.version.read_text(encoding="utf-8")
        return urllib.request.Request(self.archive.url, headers=headers)

    def _refused(self, error: urllib.error.HTTPError) -> None:
        """An answer that is no file: over the end of what is there, passing, or final."""
        if error.code == 416 and self.size:
            whole = re.fullmatch(r"bytes \*/(\d+)", error.headers.get("Content-Range", ""))
            self.complete = self.size == (int(whole[1]) if whole else self.archive.bytes)
            if not self.complete:
                self._restart()
            return
        if error.code in PASSING:
            raise error
        self._wrong(f"answers {error.code} {error.reason}")

    def _accepted(self, response: http.client.HTTPResponse) -> int | None:
        """The file's whole size as the answer states it, after checking that it continues what is there."""
        if response.headers.get_content_type() == "text/html":
            self._wrong("answers with a web page in place of the archive")
        found = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", response.headers.get("Content-Range", ""))
        if response.status == 206 and found and int(found[1]) == self.size:
            total = None if found[2] == "*" else int(found[2])
        elif response.status == 206:
            self._restart()
            raise http.client.HTTPException("another part than the one asked for")
        else:
            self._restart()
            length = response.headers.get("Content-Length")
            total = int(length) if length else None
        if self.archive.bytes is not None and total not in (None, self.archive.bytes):
            self._wrong(f"has {total} bytes where {self.archive.bytes} are recorded")
        self.md5 = served_md5(response.headers) or self.md5
        tag = response.headers.get("ETag", "")
        if tag and not tag.startswith("W/"):
            self.version.write_text(tag, encoding="utf-8")
        return total

    def _room(self, total: int | None) -> None:
        check_room(self.path.parent, (total or self.archive.bytes or 0) - self.size, self.path.name)

    def _write(self, block: bytes) -> None:
        rest = memoryview(block)
        try:
            while rest:
                written = self.part.write(rest)
                self.size += written
                rest = rest[written:]
        except OSError as error:
            raise unwritable(self.path, error) from error

    def _restart(self) -> None:
        self.part.seek(0)
        self.part.truncate()
        self.size = 0

    def _wrong(self, received: str) -> None:
        remedy = f"see {self.page or 'its authors'} for where it is now, and give that address, size and checksum as "
        hand = f"dataset.archives.KEY.url (bytes, sha256), or put the file at {self.path} by hand"
        raise InputError(self.archive.url, received, remedy + hand)


def check_room(folder: Path, needed: int, what: str) -> None:
    """Refuse to begin what the disk cannot hold.

    Args:
        folder: on the disk that is written to.
        needed: bytes.
        what: that is written, for the error.

    Raises:
        InputError: less is free.
    """
    free = shutil.disk_usage(folder).free
    if needed > free:
        received = f"has {free / 1e9:.2f} GB free where {what} needs {needed / 1e9:.2f} GB"
        raise InputError(folder, received, "free some space or choose another folder=")


@contextmanager
def _locked(part: Path) -> Iterator[FileIO]:
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
