"""Writing files whole or not at all: a killed run, or a full disk, leaves either the old file or none."""

import io
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from gaussian_enhancer.errors import InputError


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
