"""Pages are stale once what they were made with changes, and false where they claim otherwise."""

import json
import subprocess
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from ablations.jobs.fresh import CommittedPage, age, pages
from support.paths import CONF, ROOT

CFG = OmegaConf.load(f"{CONF}/fresh.yaml")
WEIGHTS, NETWORK = "src/gaussian_enhancer/weights/lr.safetensors", "src/gaussian_enhancer/network/sif.py"
PAGE = CommittedPage("page.md", ("page.jsonl",), {name: CFG.inputs[name] for name in ("weights", "network")})


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A repository with weights, a network, and a page that was made at its first commit."""
    _run(tmp_path, "init", "-q")
    for path in (WEIGHTS, NETWORK):
        (tmp_path / path).parent.mkdir(parents=True)
        _changed(tmp_path, path)
    (tmp_path / "page.jsonl").write_text(json.dumps({"commit": _commit(tmp_path)}) + "\n")
    (tmp_path / "page.md").write_text("Made with weights as shipped.\n")
    return tmp_path


def _run(folder: Path, *arguments: str) -> str:
    own = ["-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false"]
    command = ["git", "-C", str(folder), *own, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def _changed(folder: Path, path: str) -> None:
    with (folder / path).open("a", encoding="utf-8") as file:
        file.write("more\n")


def _commit(folder: Path) -> str:
    _run(folder, "add", "-A")
    _run(folder, "commit", "-q", "--no-verify", "-m", "more")
    return _run(folder, "rev-parse", "--short=10", "HEAD")


def test_a_page_is_fresh_until_an_input_changes(repository: Path) -> None:
    _commit(repository)
    assert not age(repository, PAGE).stale
    _changed(repository, NETWORK)
    _commit(repository)
    found = age(repository, PAGE)
    assert dict(found.changed) == {"network": (NETWORK,)}
    assert found.behind == 2
    assert found.stale
    assert not found.false
    assert str(found) == "stale  page.md: network (1 files); 2 commits behind"


def test_an_excluded_file_counts_only_for_pages_that_name_it(repository: Path) -> None:
    excluded = "src/gaussian_enhancer/infer/earlier_step.py"
    named = CommittedPage("page.md", ("page.jsonl",), {"earlier_step": CFG.inputs["earlier_step"]})
    (repository / excluded).parent.mkdir(parents=True)
    _changed(repository, excluded)
    _commit(repository)
    assert not age(repository, PAGE).stale
    assert dict(age(repository, named).changed) == {"earlier_step": (excluded,)}


@pytest.mark.parametrize(
    ("source", "counts"),
    [
        (
            '"""Other words."""\n\nSIDE = 3\n"""In pixels."""\n\n\ndef area() -> int:\n    return SIDE**2  # why\n',
            False,
        ),
        ("SIDE = 4\n\n\ndef area() -> int:\n    return SIDE**2\n", True),
        ("SIDE = 3\n\n\ndef area() -> int:\n    return SIDE\n", True),
        ("no program\n", True),
    ],
)
def test_docstrings_comments_and_layout_do_not_count(repository: Path, source: str, counts: bool) -> None:
    (repository / NETWORK).write_text(
        '"""Words."""\n\nSIDE = 3\n\n\ndef area() -> int:\n    """Of it."""\n    return SIDE ** 2\n'
    )
    (repository / "page.jsonl").write_text(json.dumps({"commit": _commit(repository)}) + "\n")
    (repository / NETWORK).write_text(source)
    assert age(repository, PAGE).stale == counts


RECIPE = "conf/recipe/lr.yaml"


@pytest.mark.parametrize(
    ("source", "counts"),
    [
        ("# @package _global_\n# Other words.\nsteps: 3  # why\n", False),
        ("# @package _global_\nsteps: 4\n", True),
        ("# Words.\nsteps: 3\n", True),
        ("steps: [\n", True),
    ],
)
def test_comments_of_configurations_do_not_count_but_their_header_does(
    repository: Path, source: str, counts: bool
) -> None:
    (repository / RECIPE).parent.mkdir(parents=True)
    (repository / RECIPE).write_text("# @package _global_\n# Words.\nsteps: 3\n")
    (repository / "page.jsonl").write_text(json.dumps({"commit": _commit(repository)}) + "\n")
    (repository / RECIPE).write_text(source)
    page = CommittedPage("page.md", ("page.jsonl",), {"train": CFG.inputs["train"]})
    assert age(repository, page).stale == counts


def test_a_change_that_is_not_committed_counts(repository: Path) -> None:
    _changed(repository, NETWORK)
    assert age(repository, PAGE).stale


def test_a_page_that_claims_shipped_weights_is_false_once_they_change(repository: Path) -> None:
    _changed(repository, WEIGHTS)
    assert age(repository, PAGE).false
    (repository / "page.md").write_text("Made with the weights of that commit.\n")
    assert age(repository, PAGE).stale
    assert not age(repository, PAGE).false


@pytest.mark.parametrize(("line", "told"), [({"commit": "0123456789"}, "unknown commit 0123456789"), ({}, "no commit")])
def test_what_cannot_be_told_is_stale(repository: Path, line: dict[str, str], told: str) -> None:
    (repository / "page.jsonl").write_text(json.dumps(line) + "\n")
    found = age(repository, PAGE)
    assert found.stale
    assert not found.false  # a shallow clone is no false page
    assert told in str(found)


def test_every_page_and_its_records_and_inputs_are_there() -> None:
    for page in pages(ROOT, CFG):
        assert (ROOT / page.path).is_file()
        assert all((ROOT / file).is_file() for file in page.records)
    assert len(pages(ROOT, CFG)) > len(CFG.pages)
    for specs in CFG.inputs.values():
        for spec in specs:
            assert list(ROOT.glob(spec.removeprefix(":!"))), spec


def test_no_committed_page_claims_what_is_no_longer_so() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("no history")
    assert [str(one) for one in (age(ROOT, page) for page in pages(ROOT, CFG)) if one.false] == []
