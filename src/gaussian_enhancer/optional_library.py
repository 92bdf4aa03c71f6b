"""Libraries that an extra of the package brings, imported where they are used."""

from importlib import import_module
from typing import Any

from gaussian_enhancer.errors import InputError


def optional_library(module: str, subject: str, extra: str, *, name: str = "", otherwise: str = "") -> Any:
    """Import a library that not every installation has.

    Args:
        module: what is imported.
        subject: what needs it, named as the user knows it.
        extra: the extra of this package that brings it.
        name: what the library calls itself, where its module is called otherwise.
        otherwise: what the user can do without it, as an imperative.

    Raises:
        InputError: it cannot be imported.
    """
    try:
        return import_module(module)
    except ImportError as error:
        received = f"needs {name or module}, which cannot be imported ({error})"
        remedy = f'install it with pip install "gaussian-enhancer[{extra}]"'
        raise InputError(subject, received, f"{remedy}, or {otherwise}" if otherwise else remedy) from error
