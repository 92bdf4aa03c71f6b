"""The types of artefact that stage 1 knows: each module of `degrade.artefacts` with a function of the module's name.

A new type is a new file there, and one line in ``conf/artefacts/all.yaml``, which lets a command line switch it off.
"""

import importlib
import pkgutil
from collections.abc import Mapping

from gaussian_enhancer.degrade import artefacts
from gaussian_enhancer.degrade.artefacts.view import Artefact


def find_artefacts() -> dict[str, Artefact]:
    """The function of each type, in alphabetical order."""
    found = {}
    for name in sorted(module.name for module in pkgutil.iter_modules(artefacts.__path__)):
        function = getattr(importlib.import_module(f"{artefacts.__name__}.{name}"), name, None)
        if function is not None:
            found[name] = function
    return found


ARTEFACTS: Mapping[str, Artefact] = find_artefacts()
"""The function of each type."""
TYPES = tuple(ARTEFACTS)
"""Every type of stage 1."""
