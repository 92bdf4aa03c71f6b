"""What is read before anything is written: what comes into question, and nothing else."""

from pathlib import Path

import pytest

from gaussian_enhancer.align.references import ReferenceConfig, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.plan import Rules
from gaussian_enhancer.infer.preload import validation_reads
from gaussian_enhancer.infer.validated_inputs import ValidatedInputs, validate_inputs
from gaussian_enhancer.scene.renders import read_run
from support.synthetic_runs import write_plane_run

PREPARATION = ReferenceConfig(references=1, candidates=2)
AUTO = Rules("auto", "auto", "auto")


def truncate(image: Path) -> None:
    """Leave the header and half of what follows."""
    image.write_bytes(image.read_bytes()[: image.stat().st_size // 2])


def read_all(folder: Path, rules: Rules = AUTO, *, keep_photos: bool = False) -> ValidatedInputs:
    found = validate_inputs(read_run(folder), PREPARATION, rules)
    planner = found.planner(rules)
    for read in validation_reads(found, planner, keep_photos=keep_photos):
        read()
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_plane_run(tmp_path / "run", views=16)


@pytest.fixture
def needed(folder: Path) -> set[str]:
    """Names of the references that come into question for any target."""
    found = validate_inputs(read_run(folder), PREPARATION, Rules())
    each = (PREPARATION.nearest_candidates(read_target(view), view, found.pool) for view in found.rendered.targets)
    return {found.pool.views[index].name for indices in each for index in indices}


@pytest.mark.parametrize("rules", [AUTO, Rules()])
def test_damage_is_found_in_what_comes_into_question_and_nowhere_else(folder: Path, needed: set[str], rules: Rules):
    photos = folder / "train/ours_100/gt"
    spare = sorted({path.name for path in photos.iterdir()} - needed)
    assert spare
    truncate(photos / spare[0])
    read_all(folder, rules)
    truncate(photos / max(needed))
    with pytest.raises(InputError, match=max(needed)):
        read_all(folder, rules)


def test_targets_and_where_they_are_kept_their_photos_are_read(folder: Path):
    truncate(folder / "test/ours_100/gt/view_004.png")
    read_all(folder)
    with pytest.raises(InputError, match=r"gt/view_004\.png"):
        read_all(folder, keep_photos=True)
    truncate(folder / "test/ours_100/renders/view_008.png")
    with pytest.raises(InputError, match=r"renders/view_008\.png"):
        read_all(folder)


def test_what_was_read_stays_in_memory(folder: Path, needed: set[str]):
    found = read_all(folder, Rules())
    for name in needed:
        (folder / "train/ours_100/gt" / name).unlink()
    for view in found.rendered.targets:
        assert PREPARATION.align(read_target(view), view, found.pool).names
