"""Files: written whole or not at all, read by one thread at a time.

A killed run, or a full disk, leaves either the old file or none.
"""

import io
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

_headers = threading.RLock()
if hasattr(os, "register_at_fork"):  # a worker that is forked while a thread reads a header is not left waiting for it
    os.register_at_fork(before=_headers.acquire, after_in_parent=_headers.release, after_in_child=_headers.release)


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` that takes its place when the block ends without an error.

    Parent folders are made. The temporary file keeps the ending, for writers that choose by it.

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
        raise unwritable(path, error) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def save_array(path: str | Path, array: np.ndarray) -> None:
    """Write an array as .npy, whole or not at all.

    `numpy.save` hands arrays to C and does not see a full disk refuse the last few kilobytes, so that a file without
    an error may be cut. Python's own writing does see it.

    Args:
        path: the file to write, with its ending.
        array: what to write.

    Raises:
        InputError: if the system refuses to write.
    """
    content = io.BytesIO()
    np.save(content, array)
    with whole_file(path) as temporary:
        temporary.write_bytes(content.getbuffer())


def load_array(path: str | Path, name: Callable[[list[str]], str] | None = None) -> np.ndarray:
    """Read an array of a .npy, mapped from the file, or of a .npz.

    NumPy parses an array's header with `ast`, which in Python 3.11 before 3.11.8 fails now and then with a SystemError
    when several threads do so (python/cpython#106905). Threads of this project do it in turn.

    Args:
        path: the file.
        name: chooses the array of a .npz among its names; None where a .npz is not expected.

    Raises:
        OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError: what NumPy raises for a file that is damaged.
    """
    with _headers:
        stored = np.load(path, mmap_mode="r", allow_pickle=False)
        if isinstance(stored, np.ndarray):
            return stored
        with stored:
            if name is None:
                raise ValueError("holds several arrays, one is expected")
            return stored[name(stored.files)]


def array_header(path: str | Path, name: Callable[[list[str]], str] | None = None) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type of the array that `load_array` would read, from its header.

    Args:
        path: the file.
        name: see `load_array`.

    Raises:
        OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError: as `load_array`; a .npz with another file in it.
    """
    with _headers, open(path, "rb") as file:
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
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    return shape, dtype


def unwritable(path: str | Path, error: OSError) -> InputError:
    """The system's refusal to write ``path``, in the user's terms."""
    reason = error.strerror or str(error)
    return InputError(path, f"cannot be written ({reason})", "free some space or choose another folder")


def _umask() -> int:
    """The process's file-creation mask; the system only tells it while setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_text(path: str | Path, text: str) -> None:
    """Write a small text file so that a reader sees the old or the new content, never a part.

    Raises:
        InputError: the file cannot be written.
    """
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
