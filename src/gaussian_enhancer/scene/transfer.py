"""Resumable download of one file over HTTP."""

import http.client
import os
import re
import shutil
import urllib.error
import urllib.request
from collections.abc import Callable
from io import FileIO
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import unwritable
from gaussian_enhancer.scene.checksum import served_md5
from gaussian_enhancer.scene.datasets import Archive

BLOCK = 1 << 20
"""Bytes that are read at a time."""
PASSING = (408, 425, 429, 500, 502, 503, 504)
"""Answers that may be others a moment later."""
Advance = Callable[[int, int | None], None]
"""Told how many bytes are there, and of how many."""


class Transfer:
    """State of one download: bytes on disk, and what the server stated."""

    def __init__(
        self, archive: Archive, path: Path, part: FileIO, page: str, timeout: int | float, advance: Advance
    ) -> None:
        self.archive, self.path, self.part, self.page = archive, path, part, page
        self.timeout, self.advance = timeout, advance
        self.version = Path(f"{part.name}.etag")
        self.md5: str | None = None
        self.size = part.seek(0, os.SEEK_END)
        self.complete = False

    def attempt(self) -> None:
        """Request the missing bytes and append them; if the connection breaks, what arrived is kept."""
        try:
            response = urllib.request.urlopen(self._request(), timeout=self.timeout)
        except urllib.error.HTTPError as error:
            self._refuse_answer(error)
            return
        with response:
            total = self._accept_answer(response)
            self._check_room(total)
            self.advance(self.size, total)
            while block := response.read(BLOCK):
                self._write(block)
                self.advance(self.size, total)
        expected = total if total is not None else self.archive.bytes
        self.complete = expected is None or self.size >= expected

    def discard(self) -> None:
        """Delete the partial file."""
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

    def _refuse_answer(self, error: urllib.error.HTTPError) -> None:
        """An answer that is no file: over the end of what is there, passing, or final."""
        if error.code == 416 and self.size:
            whole = re.fullmatch(r"bytes \*/(\d+)", error.headers.get("Content-Range", ""))
            self.complete = self.size == (int(whole[1]) if whole else self.archive.bytes)
            if not self.complete:
                self._restart()
            return
        if error.code in PASSING:
            raise error
        self._wrong_answer(f"answers {error.code} {error.reason}")

    def _accept_answer(self, response: http.client.HTTPResponse) -> int | None:
        """The file's whole size as the answer states it, after checking that it continues what is there."""
        if response.headers.get_content_type() == "text/html":
            self._wrong_answer("answers with a web page in place of the archive")
        match = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", response.headers.get("Content-Range", ""))
        if response.status == 206 and match and int(match[1]) == self.size:
            total = None if match[2] == "*" else int(match[2])
        elif response.status == 206:
            self._restart()
            raise http.client.HTTPException("another part than the one asked for")
        else:
            self._restart()
            length = response.headers.get("Content-Length")
            total = int(length) if length else None
        if self.archive.bytes is not None and total not in (None, self.archive.bytes):
            self._wrong_answer(f"has {total} bytes where {self.archive.bytes} are recorded")
        self.md5 = served_md5(response.headers) or self.md5
        tag = response.headers.get("ETag", "")
        if tag and not tag.startswith("W/"):
            self.version.write_text(tag, encoding="utf-8")
        return total

    def _check_room(self, total: int | None) -> None:
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

    def _wrong_answer(self, received: str) -> None:
        remedy = f"see {self.page or 'its authors'} for where it is now, and give that address, size and checksum as "
        hand = f"dataset.archives.KEY.url (bytes, sha256), or put the file at {self.path} by hand"
        raise InputError(self.archive.url, received, remedy + hand)


def check_room(folder: Path, needed: int, what: str) -> None:
    """Refuse a download that does not fit on the disk.

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
