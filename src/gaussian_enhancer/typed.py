"""Validation of settings against the types and bounds that a dataclass or a signature states."""

import dataclasses
import json
from collections.abc import Sequence
from typing import Annotated, Any, get_args, get_type_hints

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import abbreviate

STRICT = ConfigDict(strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)

Share = Annotated[int | float, Field(ge=0, le=1)]
"""Type of a field that holds a number from 0 to 1."""

RULES = {
    "bool_type": "true or false",
    "dataclass_type": "a choice of its group",
    "dict_type": "names and values",
    "finite_number": "a finite number",
    "float_type": "a number",
    "int_from_float": "a whole number",
    "int_type": "a whole number",
    "greater_than": "a number above {gt}",
    "greater_than_equal": "a number of at least {ge}",
    "less_than": "a number below {lt}",
    "less_than_equal": "a number of at most {le}",
    "list_type": "a list",
    "literal_error": "{expected}",
    "missing": "one value more",
    "needs_python_object": "a choice of its group",
    "none_required": "null",
    "string_pattern_mismatch": "text that matches {pattern}",
    "string_type": "text",
    "tuple_type": "a list",
}
"""Permitted values for each of pydantic's error types, in words for the user."""


def check_fields(settings: Any, subject: str) -> None:
    """Refuse a settings object with a value of the wrong type, a number that is not finite, or one out of bounds.

    Bounds are stated as ``Annotated[float, Field(ge=0, le=1)]``. Dataclasses call this function in ``__post_init__``;
    fields that are dataclasses check themselves.

    Args:
        settings: a dataclass.
        subject: prefix of the field's name in errors.

    Raises:
        InputError: a field's value is invalid; the error names the field, the value and the rule.
    """
    hints = get_type_hints(type(settings), include_extras=True)
    for field in dataclasses.fields(settings):
        if not dataclasses.is_dataclass(hints[field.name]):
            check_value(getattr(settings, field.name), hints[field.name], f"{subject}{field.name}")


def check_value(value: Any, kind: Any, subject: str) -> None:
    """Refuse a value of the wrong type, or out of bounds; see `check_fields`.

    Args:
        value: the value.
        kind: the type, with its bounds.
        subject: the value's name in errors.

    Raises:
        InputError: the value is invalid.
    """
    try:
        TypeAdapter(kind, config=None if _has_rules(kind) else STRICT).validate_python(value)
    except ValidationError as error:
        raise to_input_error(error, subject, kind) from error


def check_plain(value: Any, kind: Any, subject: str) -> None:
    """Refuse a configuration's value of the wrong type: as `check_value`, but a list is accepted for a tuple as well.

    Args:
        value: a number, text, truth value or null, or lists and mappings of these.
        kind: the type, with its bounds.
        subject: the value's name in errors.

    Raises:
        InputError: the value is invalid.
    """
    try:
        TypeAdapter(kind, config=None if _has_rules(kind) else STRICT).validate_json(json.dumps(value))
    except ValidationError as error:
        raise to_input_error(error, subject, kind) from error


def to_input_error(error: ValidationError, subject: str, kind: Any = None) -> InputError:
    """Convert pydantic's error to an `InputError` that names the first invalid value and the permitted ones.

    Args:
        error: as pydantic raised it.
        subject: name of the whole value; the path to the invalid part is appended.
        kind: the expected type.
    """
    errors = error.errors(include_url=False)
    place = list(_place(errors[0]))
    # Each member of a union reports its own error for the same value.
    union_errors = [entry for entry in errors if repr(entry["input"]) == repr(errors[0]["input"])]
    rules = list(dict.fromkeys(map(_rule, union_errors)))
    if {"a number", "a finite number"} & set(rules):
        rules = [rule for rule in rules if rule != "a whole number"]
    if not place and type(None) in get_args(kind):
        rules.append("null")
    name = ".".join([*filter(None, [subject]), *place])
    return InputError(name, f"is {abbreviate(errors[0]['input'])}", f"give {' or '.join(dict.fromkeys(rules))}")


def _rule(error: ErrorDetails) -> str:
    if error["type"] == "string_type" and type(error["input"]) in (int, float):
        text = f'"{error["input"]}"'
        return f"text ({text}; on the command line '{text}')"  # which reads digits as a number
    template = RULES.get(error["type"])
    if template is not None:
        return template.format(**error.get("ctx", {}))
    message = error["msg"].removeprefix("Value error, ")
    return message.replace("Input should be ", "a value that is ")


def _place(error: ErrorDetails) -> Sequence[str]:
    """Keys and indices that lead to the invalid value, without the union members that pydantic inserts."""
    scalars = ("int", "float", "str", "bool", "none")
    kinds = ("constrained", "list[", "tuple[", "literal[", "function-", "dict[", "is-instance")
    parts = map(str, error["loc"])
    return [part for part in parts if part not in scalars and not part.startswith(kinds)]


def _has_rules(kind: Any) -> bool:
    """Whether a type defines by itself how strictly it is validated."""
    return dataclasses.is_dataclass(kind) or hasattr(kind, "__pydantic_config__") or hasattr(kind, "model_config")
