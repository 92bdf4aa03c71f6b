"""The written front door: links lead somewhere, commands compose, the README is short and shows a picture."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from hydra import compose
from PIL import Image

from ablations.scripts.before_after import DESCRIPTION
from ablations.scripts.flow_figure import flow
from gaussian_enhancer.cli.main import JOBS
from support.job_config import initialised
from support.paths import DOCS, ROOT

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
WRITTEN = [page for page in PAGES if DOCS / "results" not in page.parents]
"""Pages of prose; those under docs/results are generated."""
LINK = re.compile(r"(!?)\[[^\]]*\]\(([^()\s]+)\)")
OTHERS = ("completion", "--complete")


def names(pages: list[Path]) -> list[str]:
    return [str(page.relative_to(ROOT)) for page in pages]


def prose(page: Path) -> str:
    """The page without its blocks of code."""
    return re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub and mkdocs make them."""
    heads = re.findall(r"^#+ (.+)$", prose(page), flags=re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", head)).strip().lower() for head in heads]
    return {re.sub(r"[\s]+", "-", head) for head in plain}


def commands(page: Path) -> Iterator[list[str]]:
    """The words after ``gaussian-enhancer`` of every command that a page quotes, in blocks and in running text."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    blocks = "\n".join(re.findall(r"^```sh\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE))
    lines = [line.strip() for line in blocks.splitlines()]
    lines += [found.replace("\n", " ") for found in re.findall(r"`([^`]+)`", prose(page))]
    for line in lines:
        if line.startswith("gaussian-enhancer "):
            yield shlex.split(line, comments=True)[1:]


QUOTED = [
    pytest.param(words, id=f"{page.relative_to(ROOT)}: {' '.join(words)[:60]}")
    for page in WRITTEN
    for words in commands(page)
    if words[0] not in (*OTHERS, "JOB") and "..." not in words
]


@pytest.mark.parametrize("page", PAGES, ids=names(PAGES))
def test_links_lead_somewhere(page: Path) -> None:
    for _, target in LINK.findall(prose(page)):
        if re.match(r"https?://", target):
            continue
        path, _, anchor = target.partition("#")
        file = page if not path else (page.parent / path)
        assert file.exists(), f"{target} of {page.relative_to(ROOT)}"
        if anchor:
            assert anchor in anchors(file), f"{target} of {page.relative_to(ROOT)}"


@pytest.mark.parametrize("words", QUOTED)
def test_commands_compose(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    job, *rest = words
    assert job in JOBS
    monkeypatch.setenv("GAUSSIAN_ENHANCER_DATA", "/data")
    monkeypatch.setenv("GAUSSIAN_ENHANCER_DATASETS", "/datasets")
    multirun = any(word in ("-m", "--multirun") for word in rest)
    options = ["dry_run=true" if word == "--dry-run" else word for word in rest if not re.match(r"-m$|--(?!dry)", word)]
    if multirun:  # of a sweep, the first of the comma-separated choices
        options = [re.sub(r"^([^=\[{]+=[^,\[{]+),.*$", r"\1", word) for word in options]
    with initialised():
        assert compose(job, overrides=options, return_hydra_config=True)


def test_the_page_of_jobs_names_every_job_once() -> None:
    text = (DOCS / "jobs.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^\| `(\w+)` \| [a-z]", text, flags=re.MULTILINE)) == sorted(JOBS)


def test_pages_quote_commands() -> None:
    assert len(QUOTED) > 25


def test_the_readme_is_short_and_shows_a_picture() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= 600
    (picture,) = (target for image, target in LINK.findall(text) if image)
    assert (ROOT / picture).stat().st_size < 400_000
    assert Image.open(ROOT / picture).getexif()[DESCRIPTION] in text


def test_the_flow_is_what_its_script_draws() -> None:
    assert (DOCS / "pictures/flow.svg").read_text(encoding="utf-8") == flow()


def test_every_page_of_prose_is_in_the_sites_menu() -> None:
    menu = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    missing = [name for name in (str(page.relative_to(DOCS)) for page in WRITTEN[2:]) if name not in menu]
    assert not missing
