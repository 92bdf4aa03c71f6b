"""Safe reading of untrusted files: any defect of a file raises an `InputError`.

Before it reads a file, a reader computes from the header the most memory that it will allocate, and compares that with
a limit (`refuse_larger`). The limit is 8 GB; the environment variable ``GAUSSIAN_ENHANCER_READ_LIMIT`` sets another, in
GB.
"""

import errno
import functools
import json
import math
import os
import reprlib
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, cast

from gaussian_enhancer.errors import InputError

VARIABLE = "GAUSSIAN_ENHANCER_READ_LIMIT"
LIMIT_GB = 8.0
JSON_GROWTH = 32
"""Most bytes of Python objects per byte of parsed JSON; empty objects take the most."""
YAML_GROWTH = 256
"""Most bytes of Python objects per byte of parsed YAML, including those of the parser."""
LONGEST_NUMBER = 100
FILE_ERRORS = (
    OSError,
    EOFError,
    UnicodeError,
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
    OverflowError,
    MemoryError,
)

_F = TypeVar("_F", bound=Callable[..., Any])


def refuse_larger(subject: object, allocated: int | float, cause: str) -> None:
    """Refuse to read a file that would take more memory than the limit.

    Args:
        subject: the file, named in the error.
        allocated: the most memory that reading will allocate, in bytes.
        cause: the property of the file that requires so much, as the error states it ("is an image of 9x9 pixels").

    Raises:
        InputError: ``allocated`` exceeds the limit, or the environment variable holds no positive number.
    """
    limit = _limit()
    if allocated > limit:
        received = f"{cause}, which takes up to {allocated / 1e9:.1f} GB to read (the limit is {limit / 1e9:g} GB)"
        raise InputError(subject, received, f"get the file anew, or set {VARIABLE} to more GB if you trust it")


def regular_file(path: str | Path) -> int:
    """The size in bytes of a regular file.

    Raises:
        InputError: it does not exist, may not be read, or is a folder, or a pipe or device, which may never end.
    """
    with convert_read_errors(path):
        file_status = os.stat(path)
    if stat.S_ISDIR(file_status.st_mode):
        raise InputError(path, "is a folder", "name a file")
    if not stat.S_ISREG(file_status.st_mode):
        raise InputError(path, "is no regular file", "copy its content into a file")
    return file_status.st_size


def read_bytes(path: str | Path, growth: int = 1) -> bytes:
    """The content of a regular file.

    Args:
        path: the file.
        growth: most bytes of memory per byte of the file while it is parsed.

    Raises:
        InputError: see `regular_file`; or the content takes more memory than the limit.
    """
    size = regular_file(path)
    refuse_larger(path, size * growth, f"is {size} bytes long")
    with convert_read_errors(path), open(path, "rb") as file:
        return file.read(size)


def read_text(path: str | Path, growth: int = 4) -> str:
    """The content of a regular UTF-8 file, without a byte-order mark; arguments and errors as for `read_bytes`."""
    with convert_read_errors(path):
        return read_bytes(path, growth).decode("utf-8-sig")


def parse_json(text: str, subject: object) -> Any:
    """Parse JSON text.

    Args:
        text: the text.
        subject: its source, named in errors.

    Raises:
        InputError: it is malformed, nested too deeply, or holds a number of more than 100 digits.
    """
    try:
        return json.loads(text, parse_int=_parse_integer)
    except json.JSONDecodeError as error:
        received = f"is no JSON: line {error.lineno}, column {error.colno}: {error.msg}"
        raise InputError(subject, received, "correct that line or write the file again") from error
    except RecursionError as error:
        raise InputError(subject, "is JSON that is nested too deeply", "write the file again") from error
    except ValueError as error:
        raise InputError(subject, f"is JSON with {error}", "write the file again") from error


def read_yaml(path: str | Path) -> Any:
    """Read a YAML file of plain values.

    A file with aliases is refused: nested aliases may expand a few hundred bytes to gigabytes. The configurations that
    this project writes have none.

    Args:
        path: the file.

    Raises:
        InputError: see `read_text`; or it is no YAML, nested too deeply, or has an alias.
    """
    import yaml

    text = read_text(path, YAML_GROWTH)
    try:
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, yaml.SafeLoader)):
            raise InputError(path, "repeats a part of itself by a name", "write it out in full")
        return yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, f"is no YAML ({error})", "write the file again") from error


def read_configuration(path: str | Path) -> dict[str, Any]:
    """Read the configuration of a run, its ``config.yaml``, as plain values.

    Args:
        path: the file.

    Raises:
        InputError: see `read_yaml`; or it holds no mapping.
    """
    values = read_yaml(path)
    if not isinstance(values, dict):
        raise InputError(path, "is no configuration", "run the job again")
    return {str(key): value for key, value in values.items()}


def refuse_larger_archive(path: str | Path) -> None:
    """Refuse a zip archive, such as a checkpoint of torch, whose unpacked members take more memory than the limit.

    A file that is no archive is refused where its own size exceeds the limit.

    Args:
        path: the file.

    Raises:
        InputError: see `refuse_larger`.
    """
    size = regular_file(path)
    if not zipfile.is_zipfile(path):
        refuse_larger(path, size, f"is {size} bytes long")
        return
    with convert_read_errors(path), zipfile.ZipFile(path) as archive:
        unpacked = sum(member.file_size for member in archive.infolist())
    refuse_larger(path, size + unpacked, f"announces {unpacked} bytes")


def abbreviate(value: object) -> str:
    """Text of a value for an error message, shortened if the value is large or deeply nested."""
    return _SHORT.repr(value)


@contextmanager
def convert_read_errors(path: str | Path) -> Iterator[None]:
    """Convert errors of the system or of a decoder within the block to an `InputError` that names the file.

    Args:
        path: the file that is read; a system error that names another file is reported for that one.

    Raises:
        InputError: reading failed; a missing permission is reported as such.
    """
    try:
        yield
    except InputError:
        raise
    except FILE_ERRORS as error:
        raise to_input_error(path, error) from error


def reader(function: _F) -> _F:
    """Decorate a function that reads a file, so that its errors are converted as by `convert_read_errors`.

    The function's first argument is a path, or an object with an attribute ``path``.
    """

    @functools.wraps(function)
    def guarded(path: Any, *args: Any, **kwargs: Any) -> Any:
        with convert_read_errors(getattr(path, "path", path)):
            return function(path, *args, **kwargs)

    return cast(_F, guarded)


@contextmanager
def convert_decoder_errors(path: Path, remedy: str) -> Iterator[None]:
    """Convert any error of a third-party decoder to an `InputError`; such decoders promise no particular error types.

    Args:
        path: the file that is decoded.
        remedy: what to do about a damaged file.

    Raises:
        InputError: decoding failed.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise to_input_error(path, error) from error
        reason = f"{error}" if str(error) else type(error).__name__
        received = f"cannot be decoded ({path.stat().st_size} bytes: {reason})"
        raise InputError(path, received, remedy) from error


def to_input_error(path: str | Path, error: BaseException) -> InputError:
    """Convert an error on reading ``path`` to an `InputError`."""
    if isinstance(error, OSError) and error.errno is not None:
        subject = error.filename or path
        reason = error.strerror or str(error)
        if error.errno in (errno.EACCES, errno.EPERM):
            return InputError(subject, f"may not be read ({reason})", "give yourself permission to read it")
        if error.errno in (errno.ENOENT, errno.ENOTDIR):
            return InputError(subject, "does not exist", "check the path")
        return InputError(subject, f"cannot be read ({reason})", "check the path")
    if isinstance(error, UnicodeError):
        return InputError(path, f"is no UTF-8 text ({error})", "write the file again as UTF-8")
    if isinstance(error, MemoryError):
        return InputError(path, "does not fit into memory", "close other programs or use a smaller file")
    return InputError(path, f"is truncated or damaged ({error})", "copy or write the file again")


def _limit() -> float:
    """The most memory that reading one file may take, in bytes."""
    text = os.environ.get(VARIABLE, "")
    try:
        limit = float(text) if text else LIMIT_GB
    except ValueError:
        limit = math.nan
    if not limit > 0:
        raise InputError(VARIABLE, f"is {text!r}", "set it to a number of GB above 0")
    return limit * 1e9


def _parse_integer(digits: str) -> int:
    """Parse an integer of JSON; Python's own limit is thousands of digits."""
    if len(digits) > LONGEST_NUMBER:
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 80
