"""``gaussian-enhancer fresh``: lists the committed pages whose inputs have changed since they were made.

A page's records state the commit that they were made at. The page is stale where a file that it depends on (weights,
networks, splats, training) changed since. Changes of docstrings, comments and layout do not count. A page is false
where it also says "as shipped" and a shipped file has changed.
"""

import ast
import json
import re
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml
from omegaconf import DictConfig

from ablations.jobs.pages import ROOT
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.instantiate import plain_values

CLAIM = "as shipped"
"""Words of a page that are false once a shipped file has changed."""


@dataclass(frozen=True)
class CommittedPage:
    """A committed page of results.

    Args:
        path: of the page, from the repository's root.
        records: its files of records, each line a JSON object with a ``commit``.
        inputs: git pathspecs of the files that its numbers depend on, by the input's name.
    """

    path: str
    records: tuple[str, ...]
    inputs: Mapping[str, Sequence[str]]


@dataclass(frozen=True)
class Age:
    """What changed since a page's records were made.

    Args:
        page: the page.
        commits: commits that its records were made at.
        unknown: those that the repository does not have; changes since them cannot be determined.
        changed: changed files by input, without inputs that have none.
        behind: number of commits since the oldest known one.
        claims: whether the page says `CLAIM`.
    """

    page: CommittedPage
    commits: tuple[str, ...]
    unknown: tuple[str, ...]
    changed: Mapping[str, tuple[str, ...]]
    behind: int
    claims: bool

    @property
    def stale(self) -> bool:
        """Whether an input has changed, or the changes cannot be determined."""
        return bool(self.changed or self.unknown or not self.commits)

    @property
    def false(self) -> bool:
        """Whether the page says "as shipped" and shipped weights have changed since. A shallow clone may not know."""
        return self.claims and "weights" in self.changed

    def __str__(self) -> str:
        if not self.stale:
            return f"fresh  {self.page.path}"
        reasons = [f"{name} ({len(files)} files)" for name, files in self.changed.items()]
        reasons += [f"unknown commit {commit}" for commit in self.unknown]
        reasons += [] if self.commits else ["its records state no commit"]
        line = f"{'FALSE' if self.false else 'stale'}  {self.page.path}: {', '.join(reasons)}"
        return line + (f"; {self.behind} commits behind" if self.behind else "")


def pages(root: Path, cfg: DictConfig) -> tuple[CommittedPage, ...]:
    """All pages with records: the listed ones, and every committed table of the suite.

    Args:
        root: of a checkout.
        cfg: conf/fresh.yaml, composed.
    """
    values = plain_values(cfg)

    def page(path: str, records: Sequence[str], inputs: Sequence[str]) -> CommittedPage:
        return CommittedPage(path, tuple(records), {name: values["inputs"][name] for name in inputs})

    tables = sorted((root / "docs/results/tables").glob("*/*.jsonl"))
    names = [path.relative_to(root).with_suffix("").as_posix() for path in tables]
    listed = [page(path, entry["records"], entry["inputs"]) for path, entry in values["pages"].items()]
    return (*listed, *(page(f"{name}.md", (f"{name}.jsonl",), values["tables"]) for name in names))


def age(root: Path, page: CommittedPage) -> Age:
    """What changed since a page's records were made.

    Args:
        root: of a checkout with its history.
        page: one of its pages.
    """
    commits = sorted({commit.rstrip("+") for file in page.records for commit in stated_commits(root / file)})
    known_commits = [commit for commit in commits if _git(root, "cat-file", "-e", f"{commit}^{{commit}}") is not None]
    changed: dict[str, tuple[str, ...]] = {}
    for name, specs in page.inputs.items():
        files = {file for commit in known_commits for file in _changed(root, commit, specs)}
        if files:
            changed[name] = tuple(sorted(files))
    commits_behind = max(
        (int(_git(root, "rev-list", "--count", f"{commit}..HEAD") or 0) for commit in known_commits), default=0
    )
    claims = CLAIM in (root / page.path).read_text(encoding="utf-8")
    return Age(
        page, tuple(commits), tuple(c for c in commits if c not in known_commits), changed, commits_behind, claims
    )


def stated_commits(path: Path) -> set[str]:
    """The commits that a file of records states."""
    lines = path.read_text(encoding="utf-8").split("\n")
    return {str(json.loads(line).get("commit", "")) for line in lines if line.strip()} - {""}


def _git(root: Path, *arguments: str) -> str | None:
    """What git prints; None where it refuses."""
    process = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True)
    return process.stdout.strip() if process.returncode == 0 else None


def _changed(root: Path, commit: str, specs: Sequence[str]) -> list[str]:
    """Files whose content differs between a commit and the work tree: see `CONTENTS`."""
    files = [line for line in (_git(root, "diff", "--name-only", commit, "--", *specs) or "").split("\n") if line]
    return [file for file in files if not _same_content(root, commit, file)]


def _same_content(root: Path, commit: str, file: str) -> bool:
    """Whether a file differs from that of a commit in docstrings, comments and layout alone."""
    content, path = CONTENTS.get(Path(file).suffix), root / file
    before = None if content is None else _committed(root, commit, file)
    if content is None or before is None or not path.is_file():
        return False
    try:
        return content(before) == content(path.read_text(encoding="utf-8"))
    except (SyntaxError, yaml.YAMLError):
        return False


@cache
def _committed(root: Path, commit: str, file: str) -> str | None:
    return _git(root, "show", f"{commit}:{file}")


@cache
def _program(source: str) -> str:
    """A module without docstrings, those of constants included, comments and layout."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [line for line in node.body if not _is_docstring(line)]
    return ast.dump(tree)


def _is_docstring(line: ast.stmt) -> bool:
    return isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant) and isinstance(line.value.value, str)


def _settings(source: str) -> tuple[list[str], object]:
    """A configuration file without comments and layout, but with Hydra's header."""
    return re.findall(r"^# *@package .*", source, re.MULTILINE), yaml.safe_load(source)


CONTENTS: Mapping[str, Callable[[str], object]] = {".py": _program, ".yaml": _settings}
"""What counts of a file, by the ending of its name; of other files every byte counts."""


def run(cfg: DictConfig) -> None:
    """Print every page's age.

    Args:
        cfg: conf/fresh.yaml, composed.

    Raises:
        InputError: a page is false, or stale where that is asked for.
    """
    ages = [age(ROOT, page) for page in pages(ROOT, cfg)]
    print("\n".join(map(str, ages)))
    stale, false = sum(page_age.stale for page_age in ages), sum(page_age.false for page_age in ages)
    print(f"{len(ages)} pages: {len(ages) - stale} fresh, {stale} stale, {false} of them false")
    if false or (stale and cfg.strict):
        raise InputError("pages", f"hold {false} false and {stale - false} other stale ones", "measure them again")
