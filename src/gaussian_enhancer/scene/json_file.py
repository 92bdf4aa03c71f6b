"""Reading of other tools' JSON files, with errors that name file, line and missing key."""

import json
from pathlib import Path
from typing import Any

from gaussian_enhancer.errors import InputError


def read_json(path: Path) -> Any:
    """The parsed content of a JSON file.

    Raises:
        InputError: the file is missing or malformed; the line is named.
    """
    if not path.is_file():
        raise InputError(path, "does not exist", "check the path")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        received = f"is no JSON: line {error.lineno}, column {error.colno}: {error.msg}"
        raise InputError(path, received, "correct that line or write the file again") from error
    except UnicodeDecodeError as error:
        raise InputError(path, f"is no text: {error}", "write the file again as UTF-8") from error


def member(record: Any, key: str, where: object) -> Any:
    """``record[key]`` of a JSON object.

    Raises:
        InputError: the record is no object or lacks the key.
    """
    if not isinstance(record, dict) or key not in record:
        raise InputError(where, f"has no {key!r}", "write the file again with a tool that states it")
    return record[key]


def number(record: Any, key: str, where: object, default: int | float | None = None) -> float:
    """A numeric member of a JSON object; ``default`` where it is absent.

    Raises:
        InputError: the member is no number, or absent without a default.
    """
    if default is not None and isinstance(record, dict) and key not in record:
        return float(default)
    value = member(record, key, where)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(where, f"has {key} = {value!r}", "give a number")
    return float(value)
