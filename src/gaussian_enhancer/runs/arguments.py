"""Checks of a configuration: of inputs that exclude each other, and of values against the targets' signatures."""

import inspect
from collections.abc import Iterable, Mapping
from typing import Any, get_type_hints

from hydra.utils import get_object
from omegaconf import DictConfig, OmegaConf

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.typed import check_plain

CHECKED_PACKAGES = ("gaussian_enhancer.", "ablations.")
"""Packages whose signatures state reliable types. Other packages check their arguments themselves, or not at all."""


def only_given(inputs: Mapping[str, object], job: str, nothing: str, remedy: str) -> str:
    """Name of the input that was given, of several that exclude each other.

    Args:
        inputs: all of them by name; None is an input that was not given.
        job: name of the job, for the message.
        nothing: what the message names where no input was given.
        remedy: the message's remedy.

    Raises:
        InputError: no input was given, or several.
    """
    given = [name for name, value in inputs.items() if value is not None]
    if len(given) != 1:
        raise InputError(job, f"was given {' and '.join(given) or nothing}", remedy)
    return given[0]


def refuse_without_effect(options: Iterable[str], form: str) -> None:
    """Refuse options that were given although they have no effect.

    Args:
        options: the options that were given and have no effect.
        form: the form of input beside which they were given.

    Raises:
        InputError: there is such an option.
    """
    for name in options:
        raise InputError(name, f"was given beside {form}", f"leave {name} out: it has no effect there")


def check_arguments(node: DictConfig) -> None:
    """Refuse unknown arguments of this project's targets, and values of another type than the signature states.

    Args:
        node: configuration with ``_target_`` and its parameters; nested targets are checked as well.

    Raises:
        InputError: an argument is unknown, or its value has another type; the message names it as on the command line.
    """
    values = OmegaConf.to_container(node, resolve=True)
    if isinstance(values, dict):
        _check({str(name): value for name, value in values.items()}, str(node._get_full_key(None) or ""))


def _check(values: Mapping[str, Any], key: str) -> None:
    target = values.get("_target_")
    if isinstance(target, str) and target.startswith(CHECKED_PACKAGES) and not values.get("_partial_"):
        _check_target(target, values, key)
    for name, value in values.items():
        if isinstance(value, Mapping):
            _check(value, f"{key}.{name}" if key else name)


def _check_target(target: str, values: Mapping[str, Any], key: str) -> None:
    target_callable = get_object(target)
    parameters = inspect.signature(target_callable).parameters
    hints = _hints(target_callable)
    open_ended = any(parameter.kind == inspect.Parameter.VAR_KEYWORD for parameter in parameters.values())
    for name, value in values.items():
        if name.startswith("_"):
            continue
        subject = f"{key}.{name}" if key else name
        if name not in parameters and not open_ended:
            raise InputError(subject, f"is no option of {target.rsplit('.', 1)[1]}", f"choose {', '.join(parameters)}")
        if name in hints and not _is_built(value):
            check_plain(value, hints[name], subject)


def _hints(called: Any) -> dict[str, Any]:
    """The types that a signature states; empty where a name in it cannot be resolved at run time."""
    try:
        return get_type_hints(called.__init__ if inspect.isclass(called) else called, include_extras=True)
    except NameError:
        return {}


def _is_built(value: Any) -> bool:
    """Whether a value is a configuration with ``_target_``, or contains one, and so is built before it is passed on."""
    if isinstance(value, Mapping):
        return "_target_" in value or any(map(_is_built, value.values()))
    return isinstance(value, list) and any(map(_is_built, value))
