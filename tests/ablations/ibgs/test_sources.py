"""Which photos a view refers to, and what they say of its pixels."""

import dataclasses
import math

import pytest
import torch

from ablations.ibgs.sources import MIN_PIXELS, SourceChoice, Sources, exposure_map, mapped_colours, surface_points
from gaussian_enhancer.align.references import ReferencePool, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.types import Camera, identity_camera


def turned(degrees: float, x: float = 0.0) -> Camera:
    """A camera at x on the first axis, turned about the vertical."""
    camera = identity_camera(48, 64, 64.0)
    angle = math.radians(degrees)
    pose = torch.eye(4)
    pose[0, 0] = pose[2, 2] = math.cos(angle)
    pose[0, 2], pose[2, 0] = math.sin(angle), -math.sin(angle)
    pose[:3, 3] = -pose[:3, :3] @ torch.tensor([x, 0.0, 0.0])
    return dataclasses.replace(camera, world_to_camera=pose)


def view(name: str, camera: Camera | None, depth: float = 3.0, colour: float = 0.5) -> RenderedView:
    """A view of one colour and one depth."""

    def image() -> torch.Tensor:
        return torch.full((3, 48, 64), colour)

    return RenderedView(name, image, camera, lambda: torch.full((1, 48, 64), depth), None, image)


def test_the_nearest_candidates_below_the_angle_are_taken_and_never_the_view_itself():
    views = [view(f"{i}", turned(0, 0.1 * i)) for i in range(7)]
    choice = SourceChoice()
    assert choice.nearest(views[0], views) == (1, 2, 3, 4)
    assert choice.nearest(view("new", turned(0, 0.32)), views) == (3, 4, 2, 5)
    for degrees, seen in ((29.5, (0,)), (-29.5, (0,)), (30.5, ()), (180, ())):
        assert choice.nearest(view("target", turned(0)), [view("other", turned(degrees, 0.1))]) == seen


def test_training_views_have_no_source_of_their_own_name(plane_run):
    rendered = read_run(plane_run)
    pool, choice = ReferencePool(rendered.references), SourceChoice()
    for one in rendered.references:
        names = choice.sources(one, read_target(one), pool).names
        assert one.name not in names
        assert 1 <= len(names) <= 4
        assert len(set(names)) == len(names)


@pytest.mark.parametrize(("error", "seen"), [(0.0, True), (0.009, True), (0.011, False), (-0.011, False)])
def test_a_source_must_render_the_same_depth_within_a_hundredth(error, seen):
    target = view("target", turned(0))
    found = SourceChoice().sources(
        target, read_target(target), ReferencePool([view("other", turned(0), 3 * (1 + error))])
    )
    assert bool(found.visible.all()) == seen
    assert bool(found.visible.any()) == seen
    assert float(found.colours.max()) == (0.5 if seen else 0)


def test_at_most_three_count_at_a_pixel_the_nearest_first():
    target = view("target", turned(0))
    others = [view(f"{i}", turned(0, 0.02 * i), 3.0, 0.1 * i) for i in range(1, 6)]
    found = SourceChoice().sources(target, read_target(target), ReferencePool(others))
    assert found.names == ("1", "2", "3", "4")
    middle = found.visible[:, 0, 24, 32].tolist()
    assert middle == [True, True, True, False]
    assert float(found.colours[3].abs().max()) == 0
    blocked = [view("1", turned(0, 0.02), 2.0), *others[1:]]
    found = SourceChoice().sources(target, read_target(target), ReferencePool(blocked))
    assert found.visible[:, 0, 24, 32].tolist() == [False, True, True, True]


def test_camera_features_are_those_of_the_geometry():
    target = view("target", turned(0))
    found = SourceChoice().sources(target, read_target(target), ReferencePool([view("other", turned(0, 0.5))]))
    row, column = 20, 40
    point = 3 * torch.tensor([(column + 0.5 - 32) / 64, (row + 0.5 - 24) / 64, 1.0])
    there = point - torch.tensor([0.5, 0.0, 0.0])
    torch.testing.assert_close(found.rays[:, row, column], point / point.norm())
    expected = torch.cat([there / there.norm() - point / point.norm(), (there.norm() / point.norm()).log()[None]])
    torch.testing.assert_close(found.cameras[0, :, row, column], expected)


def test_surface_points_are_seen_where_they_came_from(plane_run):
    one = read_run(plane_run).targets[1]
    points, rays, reach = surface_points(one.camera, one.read_depth())
    local = torch.einsum("ij,jhw->ihw", one.camera.rotation, points) + one.camera.world_to_camera[:3, 3, None, None]
    torch.testing.assert_close(local[2:], one.read_depth())
    torch.testing.assert_close(one.camera.centre[:, None, None] + reach * rays, points)


def seen_by(colours: torch.Tensor, visible: torch.Tensor) -> Sources:
    """Sources of these colours, where nothing else matters."""
    height, width = colours.shape[-2:]
    cameras = torch.zeros(len(colours), 4, height, width)
    return Sources(colours, cameras, visible, torch.zeros(3, height, width), ("",) * len(colours))


def test_exposure_is_the_map_onto_the_nearest_photo_that_shows_enough():
    generator = torch.Generator().manual_seed(0)
    render = torch.rand(3, 32, 32, generator=generator)
    maps = torch.eye(3, 4) + 0.2 * torch.rand(2, 3, 4, generator=generator)
    photos = mapped_colours(render, maps[0]), mapped_colours(render, maps[1])
    visible = torch.zeros(2, 1, 32, 32, dtype=torch.bool)
    visible[0, 0].view(-1)[: MIN_PIXELS - 1] = True
    visible[1, 0].view(-1)[:MIN_PIXELS] = True
    torch.testing.assert_close(exposure_map(render, seen_by(torch.stack(photos), visible)), maps[1])
    visible[0] = True
    torch.testing.assert_close(exposure_map(render, seen_by(torch.stack(photos), visible)), maps[0])
    none = exposure_map(render, seen_by(torch.stack(photos), torch.zeros_like(visible)))
    assert torch.equal(mapped_colours(render, none), render)


def test_what_is_not_known_is_refused():
    target, other = view("target", turned(0)), view("other", turned(0))
    with pytest.raises(InputError, match="other: has no camera"):
        SourceChoice().nearest(target, [view("other", None)])
    blind = dataclasses.replace(target, read_depth=None)
    with pytest.raises(InputError, match="target: has no depth to find"):
        SourceChoice().sources(blind, read_target(blind), ReferencePool([other]))
    with pytest.raises(InputError, match="other: has no depth, which visibility requires"):
        SourceChoice().sources(
            target, read_target(target), ReferencePool([dataclasses.replace(other, read_depth=None)])
        )
    with pytest.raises(InputError, match="tolerance: is 0"):
        SourceChoice(tolerance=0.0)
