"""Import of optional libraries, which extras of the package install."""

from importlib import import_module
from typing import Any

from gaussian_enhancer.errors import InputError


def optional_library(module: str, subject: str, extra: str, *, name: str = "", otherwise: str = "") -> Any:
    """Import an optional library.

    Args:
        module: the module to import.
        subject: the feature that needs it, named as the user knows it.
        extra: the extra of this package that installs it.
        name: the library's name, where it differs from the module's.
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
