"""Building the objects that a configuration names. Nothing else in the package instantiates a ``_target_``."""

from typing import Any

import hydra
from hydra.errors import HydraException, InstantiationException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import InterpolationResolutionError

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.arguments import OURS, check_arguments


def build(node: DictConfig, *args: Any, **kwargs: Any) -> Any:
    """Build the object that a configuration node names by ``_target_``.

    Args:
        node: configuration with ``_target_`` and its parameters; nested targets are built first.
        *args: positional arguments that a configuration cannot hold.
        **kwargs: keyword arguments that a configuration cannot hold; they win over the node's.

    Raises:
        InputError: a value marked ``???`` was not given, or what is built refuses its values.
    """
    require(node)
    check_arguments(node)
    try:
        return hydra.utils.instantiate(node, *args, _convert_="all", **kwargs)
    except InstantiationException as error:
        refusal = _refusal(error, node)
        if refusal is None:
            raise
        raise refusal from error


def _refusal(error: BaseException, node: DictConfig) -> InputError | None:
    """The user's mistake that Hydra wrapped, if there is one. Other errors keep Hydra's traceback.

    Packages of others refuse values by errors of their own, or of Python's; in our code those are our mistake.
    """
    causes = [error]
    while causes[-1].__cause__ is not None:
        causes.append(causes[-1].__cause__)
    input_error = next((cause for cause in causes if isinstance(cause, InputError)), None)
    target = str(node.get("_target_"))
    if input_error is not None or target.startswith(OURS):
        return input_error
    reason = causes[-1]
    if isinstance(reason, HydraException):
        reason = error
    first_line = next(iter(str(reason).splitlines()), type(reason).__name__)
    subject = str(node._get_full_key(None) or target)
    return InputError(subject, f"is refused by {target} ({first_line})", "give values that it takes")


def require(cfg: DictConfig) -> None:
    """Refuse a configuration without a mandatory value (``???``) or an environment variable that it reads.

    Raises:
        InputError: a value marked ``???`` was not given, or a variable that the configuration reads is not set.
    """
    try:
        OmegaConf.to_container(cfg, resolve=True)
        missing = sorted(OmegaConf.missing_keys(cfg))
    except InterpolationResolutionError as error:
        cause = str(error).splitlines()[0]
        raise InputError(error.full_key, f"cannot be resolved: {cause}", "set what it refers to") from error
    if missing:
        raise InputError(missing[0], "is mandatory and was not given", f"add {' '.join(f'{n}=...' for n in missing)}")


def plain_values(values: DictConfig) -> dict[str, Any]:
    """A configuration node as plain values, resolved.

    Raises:
        InputError: it is no mapping.
    """
    container = OmegaConf.to_container(values, resolve=True)
    if not isinstance(container, dict):
        raise InputError(str(values._get_full_key(None)), "is no mapping", "give names and values")
    return {str(name): value for name, value in container.items()}
