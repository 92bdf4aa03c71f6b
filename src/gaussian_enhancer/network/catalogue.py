"""Catalogue of the package's networks by class name, built from the package's files.

A new network only needs a new file here; there is no list to edit. A weights file may only name networks of this
catalogue, so that an untrusted file never chooses which code is imported.
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
    """Network classes by name. Access to a name imports only its module; iteration imports all modules."""

    @cached_property
    def modules(self) -> dict[str, list[str]]:
        """Modules of the package by the names of the classes that their files define."""
        modules_by_class: dict[str, list[str]] = {}
        for root in map(Path, importlib.import_module(PACKAGE).__path__):
            for path in sorted(root.rglob("*.py")):
                module = ".".join((PACKAGE, *path.relative_to(root).with_suffix("").parts))
                for node in ast.parse(path.read_text(encoding="utf-8")).body:
                    if isinstance(node, ast.ClassDef) and node.bases:
                        modules_by_class.setdefault(node.name, []).append(module)
        return modules_by_class

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
