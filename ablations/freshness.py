"""Which committed pages are older than what they were made with.

    python -m ablations.freshness             # every page with what changed since; fails where one is false
    python -m ablations.freshness --strict    # fails where any page is stale as well

A page's records state the commit that they were made at. The page is stale where a file that it hangs on (weights,
networks, splats, training) changed since. It is false where it also says "as shipped" and a shipped file has changed.
"""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

INPUTS: Mapping[str, tuple[str, ...]] = {
    "weights": ("src/gaussian_enhancer/weights/*.safetensors",),
    "network": ("src/gaussian_enhancer/network", "src/gaussian_enhancer/align", "src/gaussian_enhancer/infer"),
    "splat": ("src/gaussian_enhancer/splat",),
    "distil": ("src/gaussian_enhancer/distil",),
    "train": ("src/gaussian_enhancer/train", "src/gaussian_enhancer/loss", "conf/recipe"),
    "simulator": ("src/gaussian_enhancer/degrade",),
    "scenes": ("src/gaussian_enhancer/scene",),
}
"""Paths by what they are, as git's pathspecs."""
CLAIM = "as shipped"
"""Words of a page that are false once a shipped file has changed."""


@dataclass(frozen=True)
class Page:
    """A committed page of results.

    Args:
        path: of the page, from the repository's root.
        records: its files of records, each line a JSON object with a ``commit``.
        inputs: what its numbers hang on, of `INPUTS`.
    """

    path: str
    records: tuple[str, ...]
    inputs: tuple[str, ...]


@dataclass(frozen=True)
class Age:
    """What changed since a page's records were made.

    Args:
        page: the page.
        commits: of its records.
        unknown: those that the repository does not have, so that nothing can be told of them.
        changed: changed files by input; inputs without any are left out.
        behind: commits since the oldest that is known.
        claims: whether the page says `CLAIM`.
    """

    page: Page
    commits: tuple[str, ...]
    unknown: tuple[str, ...]
    changed: Mapping[str, tuple[str, ...]]
    behind: int
    claims: bool

    @property
    def stale(self) -> bool:
        """Whether an input changed, or what changed cannot be told."""
        return bool(self.changed or self.unknown or not self.commits)

    @property
    def false(self) -> bool:
        """Whether it claims shipped weights that have changed since; in a shallow clone that may be unknown."""
        return self.claims and "weights" in self.changed

    def __str__(self) -> str:
        if not self.stale:
            return f"fresh  {self.page.path}"
        parts = [f"{name} ({len(files)} files)" for name, files in self.changed.items()]
        parts += [f"unknown commit {commit}" for commit in self.unknown]
        parts += [] if self.commits else ["its records state no commit"]
        told = f"{'FALSE' if self.false else 'stale'}  {self.page.path}: {', '.join(parts)}"
        return told + (f"; {self.behind} commits behind" if self.behind else "")


PAGES = (
    Page("docs/results/quality.md", ("docs/results/quality.jsonl",), ("weights", "network", "splat", "train")),
    Page(
        "docs/results/plan.md",
        ("docs/results/leaving_out_test.jsonl", "docs/results/leaving_out_training.jsonl"),
        ("weights", "network", "splat"),
    ),
    Page("docs/results/convergence.md", ("docs/results/convergence.jsonl",), ("weights", "network", "splat")),
    Page("docs/results/distil.md", ("docs/results/distil.jsonl",), ("weights", "network", "splat", "distil")),
    Page("docs/results/stability.md", ("docs/results/stability.jsonl",), ("weights", "network", "splat")),
    Page("docs/results/tradeoff.md", ("docs/results/tradeoff/quality.jsonl",), ("weights", "network", "splat")),
    Page("docs/results/weights.md", ("docs/results/candidates.jsonl",), ("weights", "network", "train")),
    Page(
        "docs/results/networks.md",
        ("docs/results/depth.jsonl", "docs/results/flicker.jsonl", "docs/results/evidence.jsonl"),
        ("weights", "network"),
    ),
    Page(
        "docs/results/simulator.md",
        ("docs/results/realism_test.jsonl", "docs/results/renders_test.jsonl", "docs/results/renders_validation.jsonl"),
        ("simulator", "network", "train"),
    ),
    Page("docs/video.md", ("docs/results/flicker_path.jsonl",), ("weights", "network")),
    Page("docs/results/fitting.md", ("docs/results/initialisation.jsonl",), ("splat", "scenes")),
)
"""Pages by hand; the tables of the suite are found by their files."""


def pages(root: Path) -> tuple[Page, ...]:
    """All pages with records: those of `PAGES`, and every table of the suite that was committed."""
    tables = sorted((root / "docs/results/tables").glob("*/*.jsonl"))
    names = [path.relative_to(root).with_suffix("").as_posix() for path in tables]
    hang = ("network", "splat", "train", "simulator", "scenes")
    return (*PAGES, *(Page(f"{name}.md", (f"{name}.jsonl",), hang) for name in names))


def age(root: Path, page: Page) -> Age:
    """What changed since a page's records were made.

    Args:
        root: of a checkout with its history.
        page: one of its pages.
    """
    commits = sorted({commit.rstrip("+") for file in page.records for commit in stated_commits(root / file)})
    known = [commit for commit in commits if _git(root, "cat-file", "-e", f"{commit}^{{commit}}") is not None]
    changed: dict[str, tuple[str, ...]] = {}
    for name in page.inputs:
        files = {line for commit in known for line in _lines(root, "diff", "--name-only", commit, "--", *INPUTS[name])}
        if files:
            changed[name] = tuple(sorted(files))
    behind = max((int(_git(root, "rev-list", "--count", f"{commit}..HEAD") or 0) for commit in known), default=0)
    claims = CLAIM in (root / page.path).read_text(encoding="utf-8")
    return Age(page, tuple(commits), tuple(c for c in commits if c not in known), changed, behind, claims)


def stated_commits(path: Path) -> set[str]:
    """The commits that a file of records states."""
    lines = path.read_text(encoding="utf-8").split("\n")
    return {str(json.loads(line).get("commit", "")) for line in lines if line.strip()} - {""}


def _git(root: Path, *arguments: str) -> str | None:
    """What git prints; None where it refuses."""
    found = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True)
    return found.stdout.strip() if found.returncode == 0 else None


def _lines(root: Path, *arguments: str) -> list[str]:
    return [line for line in (_git(root, *arguments) or "").split("\n") if line]


def main(arguments: Sequence[str]) -> None:
    """Print every page's age; the exit status tells whether one is false, or with ``--strict`` stale."""
    root = Path(__file__).resolve().parents[1]
    ages = [age(root, page) for page in pages(root)]
    print("\n".join(map(str, ages)))
    stale, false = sum(one.stale for one in ages), sum(one.false for one in ages)
    print(f"{len(ages)} pages: {len(ages) - stale} fresh, {stale} stale, {false} of them false")
    if false or (stale and "--strict" in arguments):
        raise SystemExit(1)


if __name__ == "__main__":
    main(sys.argv[1:])
