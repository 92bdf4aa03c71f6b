"""Values of settings checked against the types and bounds that their dataclass states."""

import dataclasses
from typing import Any, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import shown

STRICT = ConfigDict(strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)


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
        TypeAdapter(kind, config=STRICT).validate_python(value)
    except ValidationError as error:
        rule = error.errors()[0]["msg"].replace("Input should be ", "")
        raise InputError(subject, f"is {shown(value)}", f"give a value that is {rule}") from error
