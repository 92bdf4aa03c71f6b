"""Paths that pass through the textured plane, or look past it."""

import dataclasses
from pathlib import Path

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.path_surfaces import refuse_inside
from gaussian_enhancer.runs.rendered_capture import SplatRenderer, open_renderer
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.types import Camera
from support.synthetic_runs import plane_camera

CAMERAS = [plane_camera(index, 48, 64) for index in range(6)]


@pytest.fixture(scope="module")
def renderer(sheet_run: Path) -> SplatRenderer:
    return dataclasses.replace(open_renderer(sheet_run / "splat.ply", CAMERAS, (0.0, 0.0, 0.0)), near=1e-3)


def moved(forward: float, turn: torch.Tensor | None = None) -> Camera:
    pose = CAMERAS[2].world_to_camera.clone()
    pose[2, 3] -= forward
    return dataclasses.replace(CAMERAS[2], world_to_camera=pose if turn is None else turn @ pose)


def test_a_path_before_the_surface_is_taken(renderer: SplatRenderer) -> None:
    refuse_inside([*CAMERAS, moved(0.1)], CAMERAS, renderer, "path")
    refuse_inside(CAMERAS * 20, CAMERAS, renderer, "path")


def test_a_path_through_a_surface_or_past_everything_is_refused(sheet_run: Path, renderer: SplatRenderer) -> None:
    read = read_run(sheet_run).targets[0].read_depth
    assert read is not None
    distance = float(read().median())
    with pytest.raises(InputError, match=r"is inside a surface at frame 3 of 3: \d+% of the view is nearer than 3%"):
        refuse_inside([moved(0), moved(0.5 * distance), moved(0.975 * distance)], CAMERAS, renderer, "path")
    back = torch.diag(torch.tensor([-1.0, 1, -1, 1]))
    with pytest.raises(InputError, match="path: sees nothing of the splat at frame 1 of 2"):
        refuse_inside([moved(0, back), moved(0)], CAMERAS, renderer, "path")


def test_of_a_long_path_its_ends_are_tried(renderer: SplatRenderer) -> None:
    back = moved(0, torch.diag(torch.tensor([-1.0, 1, -1, 1])))
    with pytest.raises(InputError, match="at frame 500 of 500"):
        refuse_inside([*[CAMERAS[0]] * 499, back], CAMERAS, renderer, "path")
