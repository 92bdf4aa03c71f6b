"""The networks of this package by the name of their class, found by looking at its files.

A new network is a new file here: no list has to be edited. A weights file may name only what is found here, so that a
file from a stranger never chooses which code is imported.
"""

import ast
import importlib
import inspect
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path

from gaussian_enhancer.network.network import Network

PACKAGE = __name__.rpartition(".")[0]


class NetworkCatalogue(Mapping[str, type[Network]]):
    """Network classes by name. Looking one up imports its module alone; iterating imports them all."""

    @cached_property
    def modules(self) -> dict[str, list[str]]:
        """Modules of the package by the names of the classes that their files define."""
        found: dict[str, list[str]] = {}
        for root in map(Path, importlib.import_module(PACKAGE).__path__):
            for path in sorted(root.rglob("*.py")):
                module = ".".join((PACKAGE, *path.relative_to(root).with_suffix("").parts))
                for node in ast.parse(path.read_text(encoding="utf-8")).body:
                    if isinstance(node, ast.ClassDef) and node.bases:
                        found.setdefault(node.name, []).append(module)
        return found

    def __getitem__(self, name: str) -> type[Network]:
        for module in self.modules[name]:
            kind = getattr(importlib.import_module(module), name)
            if inspect.isclass(kind) and issubclass(kind, Network) and not inspect.isabstract(kind):
                return kind
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        return (name for name in self.modules if self.get(name) is not None)

    def __len__(self) -> int:
        return sum(1 for _ in self)
