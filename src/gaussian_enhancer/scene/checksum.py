"""Checksums of archives: recorded, sent by the server, or taken from the first copy.

Where nobody publishes a checksum, the first copy's SHA-256 is written beside it (``FILE.sha256``, as ``sha256sum``
writes it), and every later copy has to have the same.
"""

import base64
import binascii
import hashlib
import re
from email.message import Message
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.scene.datasets import Archive


def check_archive(archive: Archive, file: Path, place: Path, md5: str | None = None) -> str:
    """Compare a file's size and checksums with what is known of it.

    Args:
        archive: what it should be.
        file: what is there.
        place: its final name, whose ``.sha256`` holds the first copy's checksum and is written where there is none.
        md5: what the server stated.

    Returns:
        Its SHA-256.

    Raises:
        InputError: size or checksum are others.
    """
    size = file.stat().st_size
    if archive.bytes not in (None, size):
        raise InputError(place, f"has {size} bytes where {archive.bytes} are recorded", _remedy(place))
    with file.open("rb") as opened:
        sha256 = hashlib.file_digest(opened, "sha256").hexdigest()
    beside = place.with_name(f"{place.name}.sha256")
    stated = {"recorded": archive.sha256, f"in {beside.name}": _first_word(beside)}
    for origin, expected in stated.items():
        if expected not in (None, sha256):
            raise InputError(place, f"has SHA-256 {sha256} where {expected} is {origin}", _remedy(place))
    for origin, expected in {"recorded": archive.md5, "stated by the server": md5}.items():
        if expected is not None and expected != (computed := _md5(file)):
            raise InputError(place, f"has MD5 {computed} where {expected} is {origin}", _remedy(place))
    if stated[f"in {beside.name}"] is None:
        write_text(beside, f"{sha256}  {place.name}\n")
    return sha256


def served_md5(headers: Message) -> str | None:
    """The MD5 that Google's storage sends along (``x-goog-hash: crc32c=..., md5=...``), in hexadecimal digits."""
    sent = ",".join(headers.get_all("x-goog-hash") or [])
    match = re.search(r"md5=([A-Za-z0-9+/]+=*)", sent)
    if match is None:
        return None
    try:
        return base64.b64decode(match[1], validate=True).hex()
    except binascii.Error:
        return None


def _first_word(beside: Path) -> str | None:
    if not beside.is_file():
        return None
    words = beside.read_text(encoding="utf-8").split()
    if not words or not re.fullmatch(r"[0-9a-f]{64}", words[0]):
        raise InputError(beside, "holds no SHA-256", "delete it, and the archive with it, to fetch both again")
    return words[0]


def _md5(file: Path) -> str:
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, lambda: hashlib.md5(usedforsecurity=False)).hexdigest()


def _remedy(place: Path) -> str:
    return (
        f"delete {place.name} if it is there and fetch it again; if its authors have changed it, delete "
        f"{place.name}.sha256 too and give dataset.archives.KEY.bytes, .sha256 and .md5 anew (null: unknown)"
    )
