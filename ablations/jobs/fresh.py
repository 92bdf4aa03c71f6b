"""``gaussian-enhancer fresh``: lists the committed pages whose inputs have changed since they were made.

A page's records state the commit that they were made at. The page is stale where a file that it depends on (weights,
networks, splats, training) changed since. Changes of docstrings, comments and layout do not count. A page is false
where it also says "shipped" and its records are of other weights than those that are shipped now.
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
from gaussian_enhancer.checkpoint import checkpoint_digest
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.instantiate import plain_values

CLAIM = re.compile(r"\bshipped\b", re.IGNORECASE)
"""The word by which a page claims that its numbers hold for the shipped weights."""
WEIGHTS = "src/gaussian_enhancer/weights"
"""Folder of the shipped weights."""
DIGEST = re.compile(r"\b[0-9a-f]{64}\b")
"""A digest of weights in a file of records (`gaussian_enhancer.checkpoint.checkpoint_digest`)."""


@dataclass(frozen=True)
class CommittedPage:
    """A committed page of results, or a section of one that has records and inputs of its own.

    Args:
        path: of the page, from the repository's root; ``PAGE#ANCHOR`` is the section with that anchor alone.
        records: its files of records: a JSON object with a ``commit`` (``.json``), or one a line.
        inputs: git pathspecs of the files that its numbers depend on, by the input's name.
    """

    path: str
    records: tuple[str, ...]
    inputs: Mapping[str, Sequence[str]]

    def text(self, root: Path) -> str:
        """The page's text, or its section's, without the sections below it.

        Args:
            root: of a checkout.

        Raises:
            InputError: the page has no such section.
        """
        file, _, anchor = self.path.partition("#")
        text = (root / file).read_text(encoding="utf-8")
        if not anchor:
            return text
        for section in re.split(r"^(?=#+ )", text, flags=re.MULTILINE):
            if re.sub(r"\W+", "-", section.partition("\n")[0].lower()).strip("-") == anchor:
                return section
        raise InputError(self.path, "names no heading of its page", "name one in conf/fresh.yaml")


@dataclass(frozen=True)
class Age:
    """What changed since a page's records were made.

    Args:
        page: the page.
        commits: commits that its records were made at.
        unknown: those that the repository does not have; changes since them cannot be determined.
        changed: changed files by input, without inputs that have none.
        behind: number of commits since the oldest known one.
        uncommitted: whether records were made in a work tree with changes that no commit has.
        false: whether the page says `CLAIM` of other weights than those that are shipped now.
    """

    page: CommittedPage
    commits: tuple[str, ...]
    unknown: tuple[str, ...]
    changed: Mapping[str, tuple[str, ...]]
    behind: int
    uncommitted: bool
    false: bool

    @property
    def stale(self) -> bool:
        """Whether an input has changed, or the changes cannot be determined."""
        return bool(self.false or self.changed or self.unknown or not self.commits)

    def __str__(self) -> str:
        note = " (measured with uncommitted changes)" if self.uncommitted else ""
        if not self.stale:
            return f"fresh  {self.page.path}{note}"
        reasons = [f"{name} ({len(files)} files)" for name, files in self.changed.items()]
        reasons += [f"unknown commit {commit}" for commit in self.unknown]
        reasons += [] if self.commits else ["its records state no commit"]
        reasons += ['says "shipped" of other weights'] if self.false else []
        line = f"{'FALSE' if self.false else 'stale'}  {self.page.path}{note}: {', '.join(reasons)}"
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
    stated = {commit for file in page.records for commit in stated_commits(root / file)}
    commits = sorted({commit.rstrip("+") for commit in stated})
    known_commits = [commit for commit in commits if _git(root, "cat-file", "-e", f"{commit}^{{commit}}") is not None]
    changed: dict[str, tuple[str, ...]] = {}
    for name, specs in page.inputs.items():
        files = {file for commit in known_commits for file in _changed(root, commit, specs)}
        if files:
            changed[name] = tuple(sorted(files))
    commits_behind = max(
        (int(_git(root, "rev-list", "--count", f"{commit}..HEAD") or 0) for commit in known_commits), default=0
    )
    return Age(
        page=page,
        commits=tuple(commits),
        unknown=tuple(commit for commit in commits if commit not in known_commits),
        changed=changed,
        behind=commits_behind,
        uncommitted=any(commit.endswith("+") for commit in stated),
        false=bool(CLAIM.search(page.text(root))) and _has_other_weights(root, page, changed),
    )


def stated_commits(path: Path) -> set[str]:
    """The commits that a file of records states."""
    text = path.read_text(encoding="utf-8")
    rows = [text] if path.suffix == ".json" else [line for line in text.split("\n") if line.strip()]
    return {str(json.loads(row).get("commit", "")) for row in rows} - {""}


def _has_other_weights(root: Path, page: CommittedPage, changed: Mapping[str, Sequence[str]]) -> bool:
    """Whether a page's records are of other weights than those that are shipped now.

    Digests tell where the records state them. Otherwise the history does, which a shallow clone may not know.
    """
    texts = [(root / file).read_text(encoding="utf-8") for file in page.records]
    if digests := {digest for text in texts for digest in DIGEST.findall(text)}:
        return bool(digests - _shipped_digests(root))
    return any(file.startswith(WEIGHTS) for files in changed.values() for file in files)


@cache
def _shipped_digests(root: Path) -> frozenset[str]:
    return frozenset(checkpoint_digest(path) for path in (root / WEIGHTS).glob("*.safetensors"))


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
