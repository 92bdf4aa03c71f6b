"""Instantiates the objects that a configuration names. No other module of the package instantiates a ``_target_``."""

import re
from typing import Any

import hydra
from hydra.errors import HydraException, InstantiationException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import InterpolationResolutionError

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.arguments import CHECKED_PACKAGES, check_arguments

UNSET_VARIABLE = re.compile(r"Environment variable '(\w+)' not found")
"""What OmegaConf says of an environment variable that is not set."""


def build(node: DictConfig, *args: Any, **kwargs: Any) -> Any:
    """Build the object that a configuration node names by ``_target_``.

    Args:
        node: configuration with ``_target_`` and its parameters; nested targets are built first.
        *args: positional arguments that cannot be written in a configuration.
        **kwargs: keyword arguments that cannot be written in a configuration; they override the node's.

    Raises:
        InputError: a value marked ``???`` was not given, or the target refuses its values.
    """
    require(node)
    check_arguments(node)
    try:
        return hydra.utils.instantiate(node, *args, _convert_="all", **kwargs)
    except InstantiationException as error:
        refusal = _to_input_error(error, node)
        if refusal is None:
            raise
        raise refusal from error


def _to_input_error(error: BaseException, node: DictConfig) -> InputError | None:
    """The InputError for a user's mistake that Hydra wrapped; None for other errors, which keep Hydra's traceback.

    Targets of other packages raise their own or built-in exceptions for refused values, so that any exception of theirs
    becomes an InputError. In this project's code any exception but InputError is a bug.
    """
    causes = [error]
    while causes[-1].__cause__ is not None:
        causes.append(causes[-1].__cause__)
    input_error = next((cause for cause in causes if isinstance(cause, InputError)), None)
    target = str(node.get("_target_"))
    if input_error is not None or target.startswith(CHECKED_PACKAGES):
        return input_error
    reason = causes[-1]
    if isinstance(reason, HydraException):
        reason = error
    first_line = next(iter(str(reason).splitlines()), type(reason).__name__)
    subject = str(node._get_full_key(None) or target)
    return InputError(subject, f"is refused by {target} ({first_line})", "give values that it takes")


def require(cfg: DictConfig) -> None:
    """Refuse a configuration that lacks a mandatory value (``???``) or an environment variable that it refers to.

    Raises:
        InputError: a value marked ``???`` was not given, or a variable that the configuration reads is not set.
    """
    try:
        OmegaConf.to_container(cfg, resolve=True)
        missing = sorted(OmegaConf.missing_keys(cfg))
    except InterpolationResolutionError as error:
        raise _unresolved(error) from error
    if missing:
        raise InputError(missing[0], "is mandatory and was not given", f"add {' '.join(f'{n}=...' for n in missing)}")


def _unresolved(error: InterpolationResolutionError) -> InputError:
    """The InputError for a value that refers to something that is not set."""
    cause, key = str(error).splitlines()[0], str(error.full_key)
    variable = UNSET_VARIABLE.search(cause)
    if variable is None:
        return InputError(key, f"cannot be resolved: {cause}", "set what it refers to")
    received = f"refers to the environment variable {variable[1]}, which is not set"
    return InputError(key, received, f"set {variable[1]}, or give {key}=...")


def plain_values(values: DictConfig) -> dict[str, Any]:
    """A configuration node as a dictionary of plain values, with interpolations resolved.

    Raises:
        InputError: the node is not a mapping.
    """
    container = OmegaConf.to_container(values, resolve=True)
    if not isinstance(container, dict):
        raise InputError(str(values._get_full_key(None)), "is no mapping", "give names and values")
    return {str(name): value for name, value in container.items()}
