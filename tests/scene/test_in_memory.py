"""Views in memory: each file is read once, and single views are spread evenly."""

import pytest
import torch

from gaussian_enhancer.scene.in_memory import read_once, single_target_sets
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView


def view(name: str, reads: list[str]) -> RenderedView:
    def read() -> torch.Tensor:
        reads.append(name)
        return torch.zeros(3, 2, 2)

    return RenderedView(name, read, read_photo=read)


def test_what_is_held_is_read_once_when_it_is_asked_for() -> None:
    reads: list[str] = []
    kept = read_once(view("a", reads))
    assert not reads
    assert kept.read() is kept.read()
    assert reads == ["a"]
    assert kept.read_photo is not None
    assert (kept.read_depth, kept.read_alpha, kept.read_fine_photo) == (None, None, None)


@pytest.mark.parametrize(
    ("count", "chosen"), [(1, ["0"]), (2, ["0", "3"]), (3, ["0", "2", "4"]), (9, list("012345")), (0, [])]
)
def test_single_views_are_spread_evenly_and_share_their_references(count, chosen) -> None:
    reads: list[str] = []
    targets, references = (tuple(view(f"{mark}{i}", reads) for i in range(6)) for mark in ("", "r"))
    sets = single_target_sets(RenderedSet("s", targets, references), count)
    assert [one.targets[0].name for one in sets] == chosen
    for one in sets:
        assert len(one.targets) == 1
        one.references[1].read()
    assert reads == ["r1"] * bool(sets)
