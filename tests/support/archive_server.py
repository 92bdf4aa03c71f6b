"""An HTTP server that behaves as badly as asked: cuts connections, ignores ranges, sends other files."""

import base64
import hashlib
import io
import threading
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


@dataclass
class Served:
    """What the server sends and how.

    Args:
        content: the file.
        cut_after: bytes after which the first answers end, one number an answer.
        ranges: whether it understands Range; otherwise everything is sent each time.
        status: another answer than the file.
        fail_first: answers of 503 before the first good one.
        kind: its content type.
        stated: the length that it states; the file's where None.
        md5: whether it sends its checksum along as Google's storage does.
    """

    content: bytes
    cut_after: list[int] = field(default_factory=list)
    ranges: bool = True
    status: int = 200
    fail_first: int = 0
    kind: str = "application/zip"
    md5: bytes | None = None
    tag: str = '"one"'
    asked: list[str | None] = field(default_factory=list)
    url: str = ""


def _handler(served: Served) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            pass

        def do_GET(self) -> None:
            asked = self.headers.get("Range")
            served.asked.append(asked)
            if served.fail_first > 0:
                served.fail_first -= 1
                self.send_error(503)
                return
            if served.status != 200:
                self.send_error(served.status)
                return
            size, begin = len(served.content), 0
            if asked and served.ranges and self.headers.get("If-Range", served.tag) == served.tag:
                begin = int(asked.removeprefix("bytes=").removesuffix("-"))
            if begin >= size > 0 and begin:
                self.send_response(416)
                self.send_header("Content-Range", f"bytes */{size}")
                self.end_headers()
                return
            self.send_response(206 if begin else 200)
            if begin:
                self.send_header("Content-Range", f"bytes {begin}-{size - 1}/{size}")
            self.send_header("Content-Type", served.kind)
            self.send_header("Content-Length", str(size - begin))
            self.send_header("ETag", served.tag)
            if served.md5 is not None:
                self.send_header("x-goog-hash", "crc32c=AAAAAA==")
                self.send_header("x-goog-hash", f"md5={base64.b64encode(served.md5).decode()}")
            self.end_headers()
            end = begin + served.cut_after.pop(0) if served.cut_after else size
            self.wfile.write(served.content[begin:end])

    return Handler


@contextmanager
def serving(content: bytes, **behaviour: object) -> Iterator[Served]:
    """A server of one file for the duration of a block; its address is ``url``."""
    served = Served(content, **behaviour)  # type: ignore[arg-type]
    server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(served))
    server.daemon_threads = True
    thread = threading.Thread(target=lambda: server.serve_forever(poll_interval=0.01))
    thread.start()
    try:
        served.url = f"http://127.0.0.1:{server.server_address[1]}/file.zip"
        yield served
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A zip file of these names and contents."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as opened:
        for name, data in files.items():
            opened.writestr(name, data)
    return content.getvalue()


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
