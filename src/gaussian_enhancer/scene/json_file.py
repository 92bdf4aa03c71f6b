"""Reading of other tools' JSON files, with errors that name the file, the line or the missing key."""

import math
from pathlib import Path
from typing import Any

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import JSON_GROWTH, abbreviate, parse_json, read_text

LARGEST_SIDE = 1_000_000
"""Maximum width or height of an image in pixels, far above any camera's."""


def read_json(path: Path) -> Any:
    """Parse a JSON file; `input_files` states which files are refused before parsing.

    Raises:
        InputError: the file is missing, too large or malformed; for malformed files the message gives the line.
    """
    return parse_json(read_text(path, JSON_GROWTH), path)


def get_member(record: Any, key: str, where: object) -> Any:
    """The member ``record[key]`` of a JSON object.

    Raises:
        InputError: the record is not an object or lacks the key.
    """
    if not isinstance(record, dict) or key not in record:
        raise InputError(where, f"has no {key!r}", "rewrite the file with a tool that writes it")
    return record[key]


def get_number(record: Any, key: str, where: object, default: int | float | None = None) -> float:
    """A member of a JSON object that is a finite number; ``default`` where it is absent.

    Raises:
        InputError: the member is not a finite number, or is absent without a default.
    """
    if default is not None and isinstance(record, dict) and key not in record:
        return float(default)
    value = get_member(record, key, where)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(where, f"has {key} = {abbreviate(value)}", "give a number")
    return float(value)


def get_pixels(record: Any, key: str, where: object, default: int | None = None) -> int:
    """A member of a JSON object that is an image's width or height in pixels; ``default`` where it is absent.

    Raises:
        InputError: the member is not an integer from 1 to 1,000,000, or is absent without a default.
    """
    value = get_number(record, key, where, default)
    if not 1 <= value <= LARGEST_SIDE or value != int(value):
        raise InputError(where, f"has {key} = {value:g}", "give a whole number of pixels above 0")
    return int(value)


def get_object(record: Any, key: str, where: object) -> dict[str, Any]:
    """A member of a JSON object that is itself an object.

    Raises:
        InputError: the member is not an object, or is absent.
    """
    value = get_member(record, key, where)
    if not isinstance(value, dict):
        raise InputError(where, f"has {key} = {abbreviate(value)}", "give an object with one entry for each")
    return value


def get_string(record: Any, key: str, where: object) -> str:
    """A member of a JSON object that is a string.

    Raises:
        InputError: the member is not a string, or is absent.
    """
    value = get_member(record, key, where)
    if not isinstance(value, str):
        raise InputError(where, f"has {key} = {abbreviate(value)}", "give text in quotes")
    return value
