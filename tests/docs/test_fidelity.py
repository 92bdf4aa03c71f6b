"""The page that holds the paper against the code: what it refers to exists, no line is left out."""

import ast
import re
from pathlib import Path

import pytest

from support.paths import DOCS, ROOT

PAGE = DOCS / "fidelity.md"
REFERENCE = re.compile(r"`((?:src|conf|tests|ablations)/[^`\s:]+)(?:::(\w+))?`")
REFERENCES = sorted(set(REFERENCE.findall(PAGE.read_text(encoding="utf-8"))))


def defined(path: Path) -> set[str]:
    """Names that a module defines at its top."""
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return {node.name for node in body if isinstance(node, ast.ClassDef | ast.FunctionDef)}


@pytest.mark.parametrize(("path", "name"), REFERENCES, ids=["::".join(filter(None, one)) for one in REFERENCES])
def test_what_the_page_refers_to_exists(path: str, name: str) -> None:
    file = ROOT / path
    assert file.is_file()
    if name:
        assert name in defined(file)


def test_every_network_and_variant_of_the_paper_is_named_or_built_by_what_is() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for file in (ROOT / "src/gaussian_enhancer/network/paper").glob("*.py"):
        for name in defined(file) - {"adjacent_features", "halved_visibility"}:
            assert f"::{name}`" in text, name


@pytest.mark.parametrize(
    ("heading", "lines"),
    [("Equations", 6), ("Algorithm 1", 6), ("Algorithm 2", 9), ("Algorithm 3", 7), ("Settings", 11)],
)
def test_no_line_is_left_out(heading: str, lines: int) -> None:
    section = re.split(r"^## ", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    (found,) = [part for part in section if part.startswith(heading)]
    rows = [line for line in found.splitlines() if line.startswith("| ")]
    assert len(rows) - 1 == lines
    assert all(line.count("|") == rows[0].count("|") for line in rows)
