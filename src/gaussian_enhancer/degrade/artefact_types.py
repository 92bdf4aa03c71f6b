"""The types of artefact of stage 1: each module of `degrade.artefacts` that has a function of the module's name.

A new type needs a new file there, and a line in ``conf/artefacts/all.yaml`` that allows the command line to disable it.
"""

import importlib
import pkgutil
from collections.abc import Mapping

from gaussian_enhancer.degrade import artefacts
from gaussian_enhancer.degrade.artefacts.view import Artefact


def find_artefacts() -> dict[str, Artefact]:
    """The function of each type, in alphabetical order of the types."""
    functions = {}
    for name in sorted(module.name for module in pkgutil.iter_modules(artefacts.__path__)):
        function = getattr(importlib.import_module(f"{artefacts.__name__}.{name}"), name, None)
        if function is not None:
            functions[name] = function
    return functions


ARTEFACTS: Mapping[str, Artefact] = find_artefacts()
"""The function of each type."""
TYPES = tuple(ARTEFACTS)
"""Names of all types."""
