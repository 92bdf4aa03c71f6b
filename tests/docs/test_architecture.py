"""The page of the architecture: imports follow its order, and its tables name each package and module."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from support.paths import DOCS, ROOT

PACKAGE = ROOT / "src/gaussian_enhancer"
PAGE = (DOCS / "how_it_works.md").read_text(encoding="utf-8")
ENTRY_POINTS = {"__init__", "__main__"}
"""Modules of the root that offer packages to the outside."""


def order() -> list[str]:
    """Packages, each of which imports only from those before it."""
    (line,) = [line for line in PAGE.splitlines() if line.startswith("scene →")]
    return line.split(" → ")


def named_in_tables() -> set[str]:
    cells = re.findall(r"^\| (`.+?`) \|", PAGE, flags=re.MULTILINE)
    return {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}


def imported(file: Path) -> Iterator[str]:
    """The packages and root modules of the project that a file imports, also inside functions."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module == "gaussian_enhancer":
            names = [f"gaussian_enhancer.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module]
        parts = [name.split(".") for name in names]
        yield from (part[1] for part in parts if part[0] == "gaussian_enhancer" and len(part) > 1)


def test_a_package_imports_only_packages_before_it() -> None:
    position = {name: place for place, name in enumerate(order())}
    wrong = [
        f"{file.relative_to(PACKAGE)} imports {name}"
        for package in position
        for file in (PACKAGE / package).rglob("*.py")
        for name in imported(file)
        if position.get(name, -1) > position[package]
    ]
    assert wrong == []


def test_modules_of_the_root_import_no_package() -> None:
    modules = [file for file in PACKAGE.glob("*.py") if file.stem not in ENTRY_POINTS]
    wrong = [f"{file.name} imports {name}" for file in modules for name in imported(file) if name in order()]
    assert wrong == []
    assert len(modules) > 5


def test_the_page_names_every_package_and_module() -> None:
    packages = {folder.name for folder in PACKAGE.iterdir() if (folder / "__init__.py").is_file()}
    assert packages - {"weights"} == set(order())
    modules = {file.stem for file in PACKAGE.glob("*.py")} - ENTRY_POINTS
    assert packages | modules <= named_in_tables() | {"weights"}
    assert all(
        (PACKAGE / name).exists() or (PACKAGE / f"{name}.py").exists() or name == "ablations"
        for name in named_in_tables()
    )


def test_the_installed_package_does_not_import_the_studies() -> None:
    assert not [
        file for file in PACKAGE.rglob("*.py") if re.search(r"^\s*(from|import) ablations", file.read_text(), re.M)
    ]
