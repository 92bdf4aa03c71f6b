"""Regions: what counts as background, how few rectangles hold the rest, and that a cut view is the same view."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from gaussian_enhancer.align.alignment import LoadedView, Reprojected
from gaussian_enhancer.infer.regions import BLOCK, background_blocks, cover_with_regions, cut_pixels
from gaussian_enhancer.types import Region
from support.projection import project
from support.synthetic_runs import plane_camera, plane_view

WHITE = (1.0, 1.0, 1.0)


def test_blocks_of_the_backgrounds_colour_are_background_up_to_the_tolerance():
    image = torch.ones(3, 40, 50)
    image[1, 5, 20] = 0.9
    image[2, 39, 49] = 0.98
    assert background_blocks(image, WHITE, 0.03).tolist() == [
        [True, False, True, True],
        [True] * 4,
        [True] * 4,
    ]
    assert not background_blocks(image, WHITE, 0.01)[2, 3]
    assert not background_blocks(image, (0.0, 0.0, 0.0), 0.03).any()


@settings(max_examples=40, deadline=None)
@given(blocks=st.lists(st.tuples(st.integers(0, 5), st.integers(0, 6)), max_size=8), margin=st.sampled_from([0, 8, 32]))
def test_regions_hold_every_needed_pixel_once_and_cost_no_more_than_one_rectangle(blocks, margin):
    needed = torch.zeros(6, 7, dtype=torch.bool)
    for row, column in blocks:
        needed[row, column] = True
    height, width = 6 * BLOCK - 5, 7 * BLOCK - 9
    times = torch.zeros(height, width)
    for region in cover_with_regions(needed, height, width, margin):
        region.crop(times).add_(1)
    wanted = needed.repeat_interleave(BLOCK, 0).repeat_interleave(BLOCK, 1)[:height, :width]
    assert (times[wanted] == 1).all()
    assert times.max() <= 1
    if blocks:
        rows, columns = needed.any(1).nonzero()[:, 0], needed.any(0).nonzero()[:, 0]
        box = (rows[-1] - rows[0] + 1) * (columns[-1] - columns[0] + 1) * BLOCK**2
        assert times.sum() <= box


def test_far_apart_things_get_regions_of_their_own_and_near_ones_share():
    needed = torch.zeros(8, 8, dtype=torch.bool)
    needed[0, 0] = needed[7, 7] = True
    assert cover_with_regions(needed, 128, 128, 16) == (Region(0, 0, 16, 16), Region(112, 112, 128, 128))
    near = torch.zeros(8, 8, dtype=torch.bool)
    near[3, 2] = near[3, 4] = True
    assert cover_with_regions(near, 128, 128, 16) == (Region(48, 32, 64, 80),)
    assert cover_with_regions(torch.zeros(8, 8, dtype=torch.bool), 128, 128, 16) == ()


def test_a_cut_camera_sees_what_the_whole_one_sees_there():
    camera, region = plane_camera(2, 48, 64), Region(8, 16, 40, 64)
    cut = camera.crop(region)
    point = torch.tensor([0.3, -0.2, 4.0])
    whole, part = (project(one, point) for one in (camera, cut))
    torch.testing.assert_close(whole - torch.tensor([16.0, 8.0]), part)
    assert (cut.height, cut.width) == (32, 48)
    assert region.relative_to(Region(0, 8, 48, 64)) == Region(8, 8, 40, 56)


@pytest.mark.parametrize("region", [Region(16, 16, 48, 48), Region(0, 0, 48, 32)])
def test_references_reach_a_cut_view_as_they_reach_the_whole(region):
    texture = torch.rand(3, 192, 192, generator=torch.Generator().manual_seed(0))
    views = []
    for index in range(3):
        camera = plane_camera(index, 48, 64)
        photo, depth = plane_view(camera, texture)
        views.append(LoadedView(f"{index}.png", photo, camera, depth, torch.ones_like(depth), render=photo))
    warp = Reprojected(depth="exact", photo_consistency=None)
    whole = warp(views[0], views[1:], 2)
    part = warp(cut_pixels(views[0], region), views[1:], 2)
    order = [whole.names.index(name) for name in part.names]
    torch.testing.assert_close(part.references, region.crop(whole.references)[order], atol=2e-4, rtol=0)
    torch.testing.assert_close(part.visibility, region.crop(whole.visibility)[order], atol=2e-4, rtol=0)
    bare = cut_pixels(replace(views[0], camera=None, depth=None, alpha=None), region)
    assert (bare.camera, bare.depth, bare.alpha) == (None, None, None)
