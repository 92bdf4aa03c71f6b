"""Atomic writing of files, their digests, and thread-safe reading of NumPy arrays.

After a killed run, or on a full disk, there is either the old file or none.
"""

import glob
import hashlib
import io
import json
import os
import tempfile
import threading
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gaussian_enhancer.errors import InputError

_umask_lock = threading.Lock()
_header_lock = threading.RLock()
if hasattr(os, "register_at_fork"):  # a worker forked while a thread holds the lock would wait for it for ever
    os.register_at_fork(
        before=_header_lock.acquire, after_in_parent=_header_lock.release, after_in_child=_header_lock.release
    )


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the folder of ``path``; it replaces ``path`` when the block ends without an error.

    Parent folders are created. The temporary file has the same extension, for writers that choose the format by it.

    Args:
        path: the file to write.

    Raises:
        InputError: if the system refuses to write (disk full, no permission); nothing is left behind.
    """
    path = Path(path)
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}.", suffix=path.suffix)
        os.close(handle)
        temporary = Path(name)
        os.chmod(temporary, 0o666 & ~_umask())
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise to_write_error(path, error) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def save_array(path: str | Path, array: np.ndarray) -> None:
    """Write an array as .npy, atomically.

    `numpy.save` writes arrays in C and does not notice when a full disk refuses the last few kilobytes: the file is
    truncated without an error. Python's own writing raises an error then.

    Args:
        path: the file to write, with its extension.
        array: the array to write.

    Raises:
        InputError: if the system refuses to write.
    """
    content = io.BytesIO()
    np.save(content, array)
    with atomic_write(path) as temporary:
        temporary.write_bytes(content.getbuffer())


def load_array(path: str | Path, name: Callable[[list[str]], str] | None = None) -> np.ndarray:
    """Read the array of a .npy, memory-mapped, or one array of a .npz.

    NumPy parses an array's header with `ast`, which in Python 3.11 before 3.11.8 fails now and then with a SystemError
    when several threads do so (python/cpython#106905). A lock lets only one thread of this project do so at a time.

    Args:
        path: the file.
        name: returns the name of the array to read, given all names in a .npz; None where a .npz is not expected.

    Raises:
        OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError: what NumPy raises for a file that is damaged.
    """
    with _header_lock:
        stored = np.load(path, mmap_mode="r", allow_pickle=False)
        if isinstance(stored, np.ndarray):
            return stored
        with stored:
            if name is None:
                raise ValueError("holds several arrays, one is expected")
            return stored[name(stored.files)]


def array_header(path: str | Path, name: Callable[[list[str]], str] | None = None) -> tuple[tuple[int, ...], np.dtype]:
    """Read shape and type of the array that `load_array` would read, from its header alone.

    Args:
        path: the file.
        name: see `load_array`.

    Raises:
        OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError: as `load_array`, or the chosen member is no .npy.
    """
    with _header_lock, open(path, "rb") as file:
        if not zipfile.is_zipfile(file):
            file.seek(0)
            return _header(file)
        if name is None:
            raise ValueError("holds several arrays, one is expected")
        with zipfile.ZipFile(file) as archive:
            names = [entry.removesuffix(".npy") for entry in archive.namelist()]
            with archive.open(f"{name(names)}.npy") as member:
                return _header(member)


def _header(file: Any) -> tuple[tuple[int, ...], np.dtype]:
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(file)
    return shape, dtype


def to_write_error(path: str | Path, error: OSError) -> InputError:
    """Convert a system error on writing ``path`` to an `InputError`."""
    reason = error.strerror or str(error)
    return InputError(path, f"cannot be written ({reason})", "free some space or choose another folder")


def _umask() -> int:
    """The process's file-creation mask. The system reports it only when a new one is set, so threads take turns."""
    with _umask_lock:
        mask = os.umask(0)
        os.umask(mask)
    return mask


def write_text(path: str | Path, text: str) -> None:
    """Write a small text file atomically: a reader sees the old or the new content, never a part.

    Raises:
        InputError: the file cannot be written.
    """
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: str | Path, value: object, indent: int | None = None) -> None:
    """Write a value atomically as JSON with a final newline.

    Args:
        path: the file.
        value: value that `json.dumps` accepts.
        indent: spaces per level; None writes one line.

    Raises:
        InputError: the file cannot be written.
    """
    write_text(path, json.dumps(value, indent=indent) + "\n")


def matching_paths(pattern: str) -> list[Path]:
    """The paths that a pattern such as ``runs/gates/*.json`` matches, in the order of their text.

    A path that exists, and one without wildcards, is taken as it is. So a folder's name may contain brackets.
    """
    if Path(pattern).exists() or not glob.has_magic(pattern):
        return [Path(pattern)]
    return [Path(path) for path in sorted(glob.glob(pattern, recursive=True))]


def file_digest(path: Path) -> str:
    """SHA-256 of a file's content, as hexadecimal digits.

    Args:
        path: the file.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
