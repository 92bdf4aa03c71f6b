"""Values of settings checked against the types and bounds that a dataclass or a signature states."""

import dataclasses
import json
from collections.abc import Sequence
from typing import Any, get_args, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import shown

STRICT = ConfigDict(strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)

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
"""What pydantic's errors ask for, in a user's words."""


def check_fields(settings: Any, subject: str) -> None:
    """Refuse a settings object with a value of another type, a number that is not finite, or one out of bounds.

    Bounds are stated as ``Annotated[float, Field(ge=0, le=1)]``. ``__post_init__`` calls it; parts that are dataclasses
    check themselves.

    Args:
        settings: a dataclass.
        subject: what the settings are called, before the field's name.

    Raises:
        InputError: a field's value is none of its type; the field, the value and the rule are named.
    """
    hints = get_type_hints(type(settings), include_extras=True)
    for field in dataclasses.fields(settings):
        if not dataclasses.is_dataclass(hints[field.name]):
            check_value(getattr(settings, field.name), hints[field.name], f"{subject}{field.name}")


def check_value(value: Any, kind: Any, subject: str) -> None:
    """Refuse a value of another type, or out of bounds; see `check_fields`.

    Args:
        value: what was given.
        kind: the type, with its bounds.
        subject: what the value is called.

    Raises:
        InputError: the value is none of its type.
    """
    try:
        TypeAdapter(kind, config=None if _has_rules(kind) else STRICT).validate_python(value)
    except ValidationError as error:
        raise refusal(error, subject, kind) from error


def check_plain(value: Any, kind: Any, subject: str) -> None:
    """Refuse a value of a configuration that is of another type: as `check_value`, but a list may be a tuple, too.

    Args:
        value: a number, text, truth value or null, or lists and mappings of these.
        kind: the type, with its bounds.
        subject: what the value is called.

    Raises:
        InputError: the value is none of its type.
    """
    try:
        TypeAdapter(kind, config=None if _has_rules(kind) else STRICT).validate_json(json.dumps(value))
    except ValidationError as error:
        raise refusal(error, subject, kind) from error


def refusal(error: ValidationError, subject: str, kind: Any = None) -> InputError:
    """The first value that pydantic refuses, and what it may be.

    Args:
        error: as pydantic raised it.
        subject: what the whole value is called; the place of a part of it is added.
        kind: the type.
    """
    found = error.errors(include_url=False)
    parts = list(_place(found[0]))
    same = [one for one in found if repr(one["input"]) == repr(found[0]["input"])]  # the members of a union
    rules = list(dict.fromkeys(map(_rule, same)))
    if {"a number", "a finite number"} & set(rules):
        rules = [rule for rule in rules if rule != "a whole number"]
    if not parts and type(None) in get_args(kind):
        rules.append("null")
    name = ".".join([*filter(None, [subject]), *parts])
    return InputError(name, f"is {shown(found[0]['input'])}", f"give {' or '.join(dict.fromkeys(rules))}")


def _rule(error: ErrorDetails) -> str:
    template = RULES.get(error["type"])
    if template is not None:
        return template.format(**error.get("ctx", {}))
    said = error["msg"].removeprefix("Value error, ")
    return said.replace("Input should be ", "a value that is ")


def _place(error: ErrorDetails) -> Sequence[str]:
    """Names and numbers of the parts that hold the value; pydantic adds the types of a union, which are left out."""
    scalars = ("int", "float", "str", "bool", "none", "constrained")
    kinds = (*scalars, "list[", "tuple[", "literal[", "function-", "dict[", "is-instance")
    return [str(part) for part in error["loc"] if not str(part).startswith(kinds)]


def _has_rules(kind: Any) -> bool:
    """Whether a type states by itself how strictly it is checked."""
    return dataclasses.is_dataclass(kind) or hasattr(kind, "__pydantic_config__") or hasattr(kind, "model_config")
