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
from gaussian_enhancer.files import to_write_error
from gaussian_enhancer.scene.checksum import served_md5
from gaussian_enhancer.scene.datasets import Archive

BLOCK = 1 << 20
"""Bytes per read."""
TEMPORARY_STATUS_CODES = (408, 425, 429, 500, 502, 503, 504)
"""HTTP status codes of temporary errors, after which the request is repeated."""
Advance = Callable[[int, int | None], None]
"""Progress callback: bytes on disk, total bytes (None where unknown)."""


class Transfer:
    """State of one download: the partial file, and the version and MD5 that the server stated."""

    def __init__(
        self, archive: Archive, path: Path, partial_file: FileIO, page: str, timeout: int | float, advance: Advance
    ) -> None:
        self.archive, self.path, self.partial_file, self.page = archive, path, partial_file, page
        self.timeout, self.advance = timeout, advance
        self.version_file = Path(f"{partial_file.name}.etag")
        self.md5: str | None = None
        self.size = partial_file.seek(0, os.SEEK_END)
        self.complete = False

    def attempt(self) -> None:
        """Request the missing bytes and append them; bytes received before a broken connection are kept."""
        try:
            response = urllib.request.urlopen(self._request(), timeout=self.timeout)
        except urllib.error.HTTPError as error:
            self._handle_http_error(error)
            return
        with response:
            total = self._check_response(response)
            self._check_room(total)
            self.advance(self.size, total)
            while block := response.read(BLOCK):
                self._write(block)
                self.advance(self.size, total)
        expected = total if total is not None else self.archive.bytes
        self.complete = expected is None or self.size >= expected

    def discard(self) -> None:
        """Delete the partial file, which must be closed, and its stored version."""
        Path(str(self.partial_file.name)).unlink(missing_ok=True)
        self.version_file.unlink(missing_ok=True)

    def _request(self) -> urllib.request.Request:
        headers = {"User-Agent": "gaussian-enhancer", "Accept-Encoding": "identity"}
        if self.size:
            headers["Range"] = f"bytes={self.size}-"
            if self.version_file.is_file():
                headers["If-Range"] = self.version_file.read_text(encoding="utf-8")
        return urllib.request.Request(self.archive.url, headers=headers)

    def _handle_http_error(self, error: urllib.error.HTTPError) -> None:
        """Handle an HTTP error: a range past the end of the file, a temporary error, or a permanent error.

        Raises:
            urllib.error.HTTPError: the error is temporary.
            InputError: the error is permanent.
        """
        if error.code == 416 and self.size:
            stated_size = re.fullmatch(r"bytes \*/(\d+)", error.headers.get("Content-Range", ""))
            self.complete = self.size == (int(stated_size[1]) if stated_size else self.archive.bytes)
            if not self.complete:
                self._restart()
            return
        if error.code in TEMPORARY_STATUS_CODES:
            raise error
        self._refuse_response(f"answers {error.code} {error.reason}")

    def _check_response(self, response: http.client.HTTPResponse) -> int | None:
        """Total size stated by the response (None if unknown), after checking that it continues the partial file.

        A response that holds the whole file truncates the partial file.
        """
        if response.headers.get_content_type() == "text/html":
            self._refuse_response("returned a web page instead of the archive")
        match = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", response.headers.get("Content-Range", ""))
        if response.status == 206 and match and int(match[1]) == self.size:
            total = None if match[2] == "*" else int(match[2])
        elif response.status == 206:
            self._restart()
            raise http.client.HTTPException("a part other than the requested one")
        else:
            self._restart()
            length = response.headers.get("Content-Length")
            total = int(length) if length else None
        if self.archive.bytes is not None and total not in (None, self.archive.bytes):
            self._refuse_response(f"has {total} bytes where {self.archive.bytes} are recorded")
        self.md5 = served_md5(response.headers) or self.md5
        etag = response.headers.get("ETag", "")
        if etag and not etag.startswith("W/"):
            self.version_file.write_text(etag, encoding="utf-8")
        return total

    def _check_room(self, total: int | None) -> None:
        check_room(self.path.parent, (total or self.archive.bytes or 0) - self.size, self.path.name)

    def _write(self, block: bytes) -> None:
        remaining = memoryview(block)
        try:
            while remaining:
                written = self.partial_file.write(remaining)
                self.size += written
                remaining = remaining[written:]
        except OSError as error:
            raise to_write_error(self.path, error) from error

    def _restart(self) -> None:
        self.partial_file.seek(0)
        self.partial_file.truncate()
        self.size = 0

    def _refuse_response(self, received: str) -> None:
        remedy = f"see {self.page or 'its authors'} for where it is now, and give that address, size and checksum as "
        alternative = f"dataset.archives.KEY.url (bytes, sha256), or put the file at {self.path} by hand"
        raise InputError(self.archive.url, received, remedy + alternative)


def check_room(folder: Path, needed: int, subject: str) -> None:
    """Refuse a download that does not fit on the disk.

    Args:
        folder: a folder on the target disk.
        needed: bytes required.
        subject: name of the data, for the error.

    Raises:
        InputError: fewer bytes are free.
    """
    free = shutil.disk_usage(folder).free
    if needed > free:
        received = f"has {free / 1e9:.2f} GB free where {subject} needs {needed / 1e9:.2f} GB"
        raise InputError(folder, received, "free some space or choose another folder=")
