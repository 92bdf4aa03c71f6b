"""Reading of other tools' JSON files, with errors that name file, line and missing key."""

import math
from pathlib import Path
from typing import Any

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import JSON_GROWTH, abbreviate, parse_json, read_text

LARGEST_SIDE = 1_000_000
"""Pixels of an image's width or height; no camera comes near."""


def read_json(path: Path) -> Any:
    """The parsed content of a JSON file; see `input_files` for what is refused before it is parsed.

    Raises:
        InputError: the file is missing, too large or malformed; the line is named.
    """
    return parse_json(read_text(path, JSON_GROWTH), path)


def member(record: Any, key: str, where: object) -> Any:
    """``record[key]`` of a JSON object.

    Raises:
        InputError: the record is no object or lacks the key.
    """
    if not isinstance(record, dict) or key not in record:
        raise InputError(where, f"has no {key!r}", "write the file again with a tool that states it")
    return record[key]


def number(record: Any, key: str, where: object, default: int | float | None = None) -> float:
    """A finite member of a JSON object; ``default`` where it is absent.

    Raises:
        InputError: the member is no finite number, or absent without a default.
    """
    if default is not None and isinstance(record, dict) and key not in record:
        return float(default)
    value = member(record, key, where)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(where, f"has {key} = {abbreviate(value)}", "give a number")
    return float(value)


def pixels(record: Any, key: str, where: object, default: int | None = None) -> int:
    """A member of a JSON object that is the width or height of an image; ``default`` where it is absent.

    Raises:
        InputError: the member is no whole number from 1 to 1,000,000, or absent without a default.
    """
    value = number(record, key, where, default)
    if not 1 <= value <= LARGEST_SIDE or value != int(value):
        raise InputError(where, f"has {key} = {value:g}", "give a whole number of pixels above 0")
    return int(value)


def mapping(record: Any, key: str, where: object) -> dict[str, Any]:
    """A member of a JSON object that is an object itself.

    Raises:
        InputError: the member is no object, or absent.
    """
    value = member(record, key, where)
    if not isinstance(value, dict):
        raise InputError(where, f"has {key} = {abbreviate(value)}", "give an object with one entry for each")
    return value


def text(record: Any, key: str, where: object) -> str:
    """A member of a JSON object that is text.

    Raises:
        InputError: the member is no text, or absent.
    """
    value = member(record, key, where)
    if not isinstance(value, str):
        raise InputError(where, f"has {key} = {abbreviate(value)}", "give text in quotes")
    return value
