"""Post-processor for Gaussian-splatting renders.

The names below are the Python API. Each is imported on first use: importing the package itself loads no other module of
it and has no side effects in the process.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gaussian_enhancer.api.enhancer import Enhancer
    from gaussian_enhancer.api.folders import enhance_folder
    from gaussian_enhancer.api.references import Reference
    from gaussian_enhancer.api.rendering import render
    from gaussian_enhancer.api.splats import distil_splat
    from gaussian_enhancer.errors import InputError
    from gaussian_enhancer.infer.weights import load_weights
    from gaussian_enhancer.splat.io.open import read_splat
    from gaussian_enhancer.types import Camera

__all__ = [
    "Camera",
    "Enhancer",
    "InputError",
    "Reference",
    "distil_splat",
    "enhance_folder",
    "load_weights",
    "read_splat",
    "render",
]

_MODULES = {
    "Camera": "types",
    "Enhancer": "api.enhancer",
    "InputError": "errors",
    "Reference": "api.references",
    "distil_splat": "api.splats",
    "enhance_folder": "api.folders",
    "load_weights": "infer.weights",
    "read_splat": "splat.io.open",
    "render": "api.rendering",
}


def __getattr__(name: str) -> Any:
    """Import a name of the API on first access (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    """Names of the module and of the API, for tab completion."""
    return sorted({*globals(), *__all__})
