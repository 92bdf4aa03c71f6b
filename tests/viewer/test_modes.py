import dataclasses

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.report.figures import colour_map
from gaussian_enhancer.viewer.modes import MAX_DIFFERENCE, MODES, Mode
from gaussian_enhancer.viewer.stage import StageView, Times

DARK, LIGHT = colour_map()[0], colour_map()[-1]


def view(scale: int = 1) -> StageView:
    render, enhanced = torch.full((3, 8, 20), 0.25), torch.full((3, 8 * scale, 20 * scale), 0.25)
    enhanced[:, :, 10 * scale :] += MAX_DIFFERENCE
    depth, coverage = torch.ones(1, 8, 20), torch.zeros(1, 8, 20)
    depth[:, :, 10:] = 4.0
    depth[:, 0] = 0.0
    coverage[:, :, :5] = 1.0
    return StageView(render, depth, torch.ones(1, 8, 20), enhanced, coverage, ("a.png",), Times(1.0, 2.0, 3.0))


def test_render_and_enhanced_alone():
    stage_view = view()
    assert torch.equal(Mode("render")(stage_view), stage_view.render)
    assert torch.equal(Mode("enhanced")(stage_view), stage_view.enhanced)


def test_side_by_side_and_wipe_show_the_render_on_the_left():
    stage_view = view()
    wide = Mode("side_by_side")(stage_view)
    assert wide.shape == (3, 8, 40)
    assert torch.equal(wide[..., :20], stage_view.render)
    assert torch.equal(wide[..., 20:], stage_view.enhanced)
    wiped = Mode("wipe", 0.7)(stage_view)
    assert wiped[0, 0].tolist() == pytest.approx([0.25] * 13 + [1.0] * 2 + [0.45] * 5)
    assert [Mode(name).splits_width for name in MODES].count(True) == 1


@pytest.mark.parametrize("scale", [1, 4])
def test_the_difference_is_dark_where_nothing_changes_and_lightest_from_its_end_on(scale):
    picture = Mode("difference")(view(scale))
    assert picture.shape == (3, 8 * scale, 20 * scale)
    torch.testing.assert_close(picture[:, 0, 0], DARK)
    torch.testing.assert_close(picture[:, -1, -1], LIGHT)


def test_confidence_is_light_where_every_photo_shows_the_pixel():
    picture = Mode("confidence")(view())
    torch.testing.assert_close(picture[:, 3, 4], LIGHT)
    torch.testing.assert_close(picture[:, 3, 5], DARK)
    torch.testing.assert_close(Mode("confidence")(dataclasses.replace(view(), coverage=None))[:, 3, 4], DARK)


def test_depth_is_light_where_it_is_near_and_dark_where_nothing_is():
    picture = Mode("depth")(view()).sum(0)
    assert float(picture[0, 0]) == pytest.approx(float(DARK.sum()))
    assert float(picture[3, 0]) > float(picture[3, 15]) > float(DARK.sum())
    nothing = dataclasses.replace(view(), depth=torch.zeros(1, 8, 20))
    torch.testing.assert_close(Mode("depth")(nothing), DARK[:, None, None].expand(3, 8, 20))


def test_the_modes_that_need_no_network_do_without():
    unenhanced_view = dataclasses.replace(view(), enhanced=None, coverage=None)
    assert [name for name in MODES if not Mode(name).enhances] == ["render", "depth"]
    assert torch.equal(Mode("render")(unenhanced_view), unenhanced_view.render)
    assert Mode("depth")(unenhanced_view).shape == (3, 8, 20)


def test_what_cannot_be_shown_is_refused():
    with pytest.raises(InputError, match="show: is 'normal'; choose enhanced, render, side_by_side"):
        Mode("normal")
    with pytest.raises(InputError, match=r"wipe: is 1\.5"):
        Mode("wipe", 1.5)
