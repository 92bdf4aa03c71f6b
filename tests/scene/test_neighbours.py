import dataclasses

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.neighbours import (
    camera_spacing,
    choose_references,
    covisibility,
    pose_costs,
)
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.types import Camera, identity_camera


def camera_at(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: float = 0.0) -> Camera:
    """A camera at a place, turned around the vertical axis by radians."""
    c, s = torch.cos(torch.tensor(turn)), torch.sin(torch.tensor(turn))
    pose = torch.eye(4)
    pose[:3, :3] = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T
    pose[:3, 3] = -pose[:3, :3] @ torch.tensor([x, y, z])
    return dataclasses.replace(identity_camera(24, 32, 40.0), world_to_camera=pose)


def view(name, camera=None):
    return RenderedView(name, None, camera)


def scaled(camera: Camera, scale: float) -> Camera:
    pose = camera.world_to_camera.clone()
    pose[:3, 3] *= scale
    return dataclasses.replace(camera, world_to_camera=pose)


def test_published_cost_by_hand():
    costs = pose_costs(camera_at(), [camera_at(3.0, 0.0, 4.0), camera_at(turn=torch.pi / 3), camera_at(turn=torch.pi)])
    torch.testing.assert_close(costs, torch.tensor([5.0, 25.0, 100.0], dtype=torch.float64), atol=1e-4, rtol=0)


def test_spacing_is_the_median_nearest_distance():
    cameras = [camera_at(x) for x in (0.0, 1.0, 3.0, 6.0)]
    assert camera_spacing(cameras) == pytest.approx(1.0)
    assert camera_spacing([camera_at(x) for x in (0.0, 0.0, 5.0)]) == pytest.approx(5.0)
    assert camera_spacing([camera_at(), camera_at(turn=1.0)]) == 1.0
    assert camera_spacing([camera_at()]) == 1.0


@given(scale=st.floats(1e-3, 1e3))
def test_ranking_does_not_depend_on_scene_units(scale):
    target = camera_at(0.2, 0, 0)
    cameras = [camera_at(1.0), camera_at(turn=0.2), camera_at(0, 3.0, 0), camera_at(0.5, 0, 0, 0.4), camera_at(2.0)]
    names = [f"{i}.png" for i in range(5)]
    expected = choose_references(view("t.png", target), [view(n, c) for n, c in zip(names, cameras, strict=True)], 5)
    candidates = [view(n, scaled(c, scale)) for n, c in zip(names, cameras, strict=True)]
    assert choose_references(view("t.png", scaled(target, scale)), candidates, 5) == expected


def test_target_is_never_its_own_reference():
    candidates = [view("t.png", camera_at()), view("a.png", camera_at(1.0)), view("b.png", camera_at(0.5))]
    assert choose_references(view("t.png", camera_at()), candidates, 5) == (2, 1)
    assert choose_references(view("t.png"), candidates, 5) == (2, 1)
    assert choose_references(view("t.jpg", camera_at()), candidates, 5) == (2, 1)  # the photo of the same view


def test_raised_digits_in_names_are_letters():
    references = [view("10²5.png"), view("10²12.png")]
    assert choose_references(view("10²6.png"), references, 1) == (0,)


def test_without_cameras_names_nearest_in_natural_order():
    names = ["r_1.png", "r_2.png", "r_9.png", "r_10.png", "r_30.png"]
    candidates = [view(name) for name in names]
    assert choose_references(view("r_8.png"), candidates, 3) == (1, 2, 0)
    assert choose_references(view("r_11.png"), candidates, 2) == (3, 4)
    assert choose_references(view("r_0.png"), candidates, 2) == (0, 1)


def test_some_cameras_only_are_refused():
    with pytest.raises(InputError, match=r"b\.png"):
        choose_references(view("t.png", camera_at()), [view("a.png", camera_at()), view("b.png")], 2)
    with pytest.raises(InputError, match="count"):
        choose_references(view("t.png"), [view("a.png")], 0)


def test_covisibility_by_hand():
    wall, target = torch.full((1, 24, 32), 4.0), camera_at()
    shift = 16 * 4.0 / 40.0
    others = [target, camera_at(turn=torch.pi), camera_at(shift), camera_at(z=5.0)]
    torch.testing.assert_close(covisibility(wall, target, others, stride=1), torch.tensor([1, 0, 0.5, 0]).double())
    assert covisibility(torch.zeros(1, 24, 32), target, others).tolist() == [0, 0, 0, 0]
    assert len(covisibility(wall, target, [])) == 0


def test_covisibility_counts_only_pixels_with_depth():
    half = torch.full((1, 24, 32), 4.0)
    half[..., :16] = 0
    shift = 16 * 4.0 / 40.0
    assert covisibility(half, camera_at(), [camera_at(shift), camera_at(-shift)], stride=1).tolist() == [1, 0]


def test_depth_puts_views_that_see_the_target_first():
    wall, target = torch.full((1, 24, 32), 1.0), camera_at()
    candidates = [view("beside.png", camera_at(1.5)), view("far.png", camera_at(z=-1.7)), view("x.png", camera_at(9.0))]
    assert choose_references(view("t.png", target), candidates, 1) == (0,)
    assert choose_references(view("t.png", target), candidates, 1, depth=wall) == (1,)


def test_kept_references_stay_until_another_is_clearly_better():
    target, views = view("t", camera_at(0.6)), [view("a", camera_at(0.0)), view("b", camera_at(1.0))]
    assert choose_references(target, views, 1) == (1,)
    assert choose_references(target, views, 1, previous_references=[0], hysteresis=0.5) == (0,)
    assert choose_references(view("t", camera_at(0.9)), views, 1, previous_references=[0], hysteresis=0.5) == (1,)
