"""Pages are stale once what they were made with changes, and false where they claim otherwise."""

import json
import subprocess
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf
from safetensors.torch import save_file

from ablations.jobs.fresh import CLAIM, CommittedPage, age, pages, stated_commits
from gaussian_enhancer.checkpoint import checkpoint_digest
from gaussian_enhancer.errors import InputError
from support.paths import CONF, DOCS, ROOT

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


@pytest.fixture
def weights(repository: Path) -> Path:
    """Shipped weights whose digest the page's records state."""
    path = repository / WEIGHTS
    save_file({"kernel": torch.ones(2)}, path)
    line = {"commit": _commit(repository), "weights": checkpoint_digest(path)}
    (repository / "page.jsonl").write_text(json.dumps(line) + "\n")
    return path


def test_a_claim_about_other_weights_than_the_shipped_ones_is_false(repository: Path, weights: Path) -> None:
    assert not age(repository, PAGE).stale
    with (repository / "page.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps({"weights": "0" * 64}) + "\n")
    found = age(repository, PAGE)
    assert found.false
    assert str(found) == 'FALSE  page.md: says "shipped" of other weights'


def test_a_claim_holds_while_the_weights_compute_the_same(repository: Path, weights: Path) -> None:
    save_file({"kernel": torch.ones(2)}, weights, {"card": json.dumps({"made": "otherwise described"})})
    found = age(repository, PAGE)
    assert found.stale  # the file has changed
    assert not found.false
    assert CLAIM.search("the shipped weights")
    assert not CLAIM.search("an unshipped one")


def test_a_work_tree_with_changes_is_named_and_does_not_fail(repository: Path) -> None:
    commit = next(iter(stated_commits(repository / "page.jsonl")))
    (repository / "page.jsonl").write_text(json.dumps({"commit": f"{commit}+"}) + "\n")
    assert str(age(repository, PAGE)) == "fresh  page.md (measured with uncommitted changes)"


def test_a_section_has_an_age_and_a_claim_of_its_own(repository: Path) -> None:
    (repository / "page.md").write_text("# Title\n\nAs shipped.\n\n## How fast it is\n\n1 s.\n\n## Else\n\nShipped.\n")
    section = CommittedPage("page.md#how-fast-it-is", PAGE.records, PAGE.inputs)
    assert section.text(repository) == "## How fast it is\n\n1 s.\n\n"
    _changed(repository, WEIGHTS)
    assert age(repository, PAGE).false
    assert age(repository, section).stale
    assert not age(repository, section).false
    with pytest.raises(InputError, match="no heading"):
        CommittedPage("page.md#other", PAGE.records, PAGE.inputs).text(repository)


def test_a_json_file_states_one_commit(tmp_path: Path) -> None:
    (tmp_path / "speed.json").write_text(json.dumps({"milliseconds": 3, "commit": "0123456789"}, indent=1))
    assert stated_commits(tmp_path / "speed.json") == {"0123456789"}


@pytest.mark.parametrize(("line", "told"), [({"commit": "0123456789"}, "unknown commit 0123456789"), ({}, "no commit")])
def test_what_cannot_be_told_is_stale(repository: Path, line: dict[str, str], told: str) -> None:
    (repository / "page.jsonl").write_text(json.dumps(line) + "\n")
    found = age(repository, PAGE)
    assert found.stale
    assert not found.false  # a shallow clone is no false page
    assert told in str(found)


def test_every_page_and_its_records_and_inputs_are_there() -> None:
    for page in pages(ROOT, CFG):
        assert page.text(ROOT)
        assert all((ROOT / file).is_file() for file in page.records)
    assert len(pages(ROOT, CFG)) > len(CFG.pages)
    for specs in CFG.inputs.values():
        for spec in specs:
            assert list(ROOT.glob(spec.removeprefix(":!"))), spec


def test_every_record_is_watched_or_historical() -> None:
    results = DOCS / "results"
    found = {path.relative_to(ROOT).as_posix() for path in (*results.rglob("*.jsonl"), *results.glob("*.json"))}
    watched = {file for page in pages(ROOT, CFG) for file in page.records}
    assert found - watched == set(CFG.historical)


def test_pages_of_the_shipped_weights_say_so() -> None:
    """A check of claims that no page makes would check nothing."""
    claiming = {page.path for page in pages(ROOT, CFG) if CLAIM.search(page.text(ROOT))}
    measured = ("test", "quality", "quality_converged_long", "convergence", "distil", "simulator", "weights")
    assert {f"docs/results/{name}.md" for name in measured} <= claiming


def test_no_committed_page_claims_what_is_no_longer_so() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("no history")
    assert [str(one) for one in (age(ROOT, page) for page in pages(ROOT, CFG)) if one.false] == []
