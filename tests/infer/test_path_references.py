import dataclasses
import itertools

import torch

from gaussian_enhancer.align.alignment import LoadedView
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool
from gaussian_enhancer.infer.path_references import PathReferences
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.types import Camera, identity_camera


def at(x: float) -> Camera:
    pose = torch.eye(4)
    pose[0, 3] = -x
    return dataclasses.replace(identity_camera(12, 16, 16.0), world_to_camera=pose)


POOL = ReferencePool([RenderedView(f"{index}.png", None, at(float(index))) for index in range(8)])


def chosen(config: ReferenceConfig, places: list[float]) -> list[tuple[int, ...]]:
    """The candidates at places along a line, one after the other."""
    found = []
    for number, x in enumerate(places):
        view = RenderedView(f"frame {number}", None, at(x))
        found.append(config.nearest_candidates(LoadedView(view.name, torch.zeros(3, 12, 16), view.camera), view, POOL))
    return found


def changes(found: list[tuple[int, ...]]) -> int:
    return sum(set(a) != set(b) for a, b in itertools.pairwise(found))


WAVERING = [3.5 + 0.1 * (-1) ** k for k in range(20)]
CONFIG = ReferenceConfig(references=1, candidates=1)


def test_a_camera_that_wavers_between_two_photos_keeps_one():
    assert changes(chosen(CONFIG, WAVERING)) == 19
    assert changes(chosen(PathReferences.from_config(CONFIG), WAVERING)) == 0


def test_a_photo_is_left_when_another_is_clearly_better():
    found = chosen(PathReferences.from_config(CONFIG), [0.1 * k for k in range(71)])
    assert found[0] == (0,)
    assert found[-1] == (7,)
    assert changes(found) <= 7
    assert all(abs(one[0] - 0.1 * k) <= 2 for k, one in enumerate(found))


def test_a_path_goes_on_where_it_stopped():
    whole = PathReferences.from_config(dataclasses.replace(CONFIG, candidates=3))
    expected = chosen(whole, WAVERING)
    first = PathReferences.from_config(dataclasses.replace(CONFIG, candidates=3))
    begun = chosen(first, WAVERING[:7])
    second = PathReferences.from_config(dataclasses.replace(CONFIG, candidates=3))
    second.kept[:] = first.kept
    assert begun + chosen(second, WAVERING[7:]) == expected


def test_without_hysteresis_and_without_references_it_chooses_as_for_single_views():
    assert chosen(PathReferences.from_config(CONFIG, hysteresis=1.0), WAVERING) == chosen(CONFIG, WAVERING)
    none = PathReferences.from_config(ReferenceConfig(references=0, candidates=0))
    assert chosen(none, WAVERING[:2]) == [(), ()]


def test_two_configurations_share_nothing():
    assert PathReferences.from_config(CONFIG).kept is not PathReferences.from_config(CONFIG).kept
