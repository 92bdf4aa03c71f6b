"""Verification of archives by checksums that are recorded, sent by the server, or taken from the first copy.

The first copy's SHA-256 is written beside it (``FILE.sha256``, in the format of ``sha256sum``), and every later copy
must have the same. This covers archives without a published checksum.
"""

import base64
import binascii
import hashlib
import re
from email.message import Message
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import file_digest, write_text
from gaussian_enhancer.scene.datasets import Archive


def check_archive(archive: Archive, file: Path, destination: Path, md5: str | None = None) -> str:
    """Compare a file's size and checksums with the expected values.

    Args:
        archive: description with the recorded values.
        file: the downloaded file.
        destination: the file's final path. The ``.sha256`` file beside it holds the first copy's checksum and is
            written if it does not exist.
        md5: MD5 stated by the server.

    Returns:
        The file's SHA-256.

    Raises:
        InputError: the size or a checksum differs.
    """
    size = file.stat().st_size
    if archive.bytes not in (None, size):
        raise InputError(destination, f"has {size} bytes where {archive.bytes} are recorded", _remedy(destination))
    sha256 = file_digest(file)
    checksum_file = destination.with_name(f"{destination.name}.sha256")
    expected_sha256 = {"recorded": archive.sha256, f"in {checksum_file.name}": _read_checksum(checksum_file)}
    for origin, expected in expected_sha256.items():
        if expected not in (None, sha256):
            raise InputError(destination, f"has SHA-256 {sha256} where {expected} is {origin}", _remedy(destination))
    for origin, expected in {"recorded": archive.md5, "stated by the server": md5}.items():
        if expected is not None and expected != (computed := _md5(file)):
            raise InputError(destination, f"has MD5 {computed} where {expected} is {origin}", _remedy(destination))
    if expected_sha256[f"in {checksum_file.name}"] is None:
        write_text(checksum_file, f"{sha256}  {destination.name}\n")
    return sha256


def served_md5(headers: Message) -> str | None:
    """Hexadecimal MD5 from Google Cloud Storage's header ``x-goog-hash: crc32c=..., md5=...``; None without one."""
    header = ",".join(headers.get_all("x-goog-hash") or [])
    match = re.search(r"md5=([A-Za-z0-9+/]+=*)", header)
    if match is None:
        return None
    try:
        return base64.b64decode(match[1], validate=True).hex()
    except binascii.Error:
        return None


def _read_checksum(checksum_file: Path) -> str | None:
    if not checksum_file.is_file():
        return None
    words = checksum_file.read_text(encoding="utf-8").split()
    if not words or not re.fullmatch(r"[0-9a-f]{64}", words[0]):
        raise InputError(checksum_file, "holds no SHA-256", "delete it, and the archive with it, to fetch both again")
    return words[0]


def _md5(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, lambda: hashlib.md5(usedforsecurity=False)).hexdigest()


def _remedy(destination: Path) -> str:
    return (
        f"delete {destination.name} if it is there and fetch it again; if its authors have changed it, delete "
        f"{destination.name}.sha256 too and give dataset.archives.KEY.bytes, .sha256 and .md5 anew (null: unknown)"
    )
