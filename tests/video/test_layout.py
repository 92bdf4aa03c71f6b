import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.video.layout import Layout

RENDER, ENHANCED = torch.full((3, 8, 20), 0.25), torch.full((3, 8, 20), 0.75)


@pytest.mark.parametrize(("kind", "left", "right"), [("enhanced", 0.75, 0.75), ("render", 0.25, 0.25)])
def test_one_view_alone(kind, left, right):
    frame = Layout(kind)(RENDER, ENHANCED, 0.0)
    assert frame.shape == (3, *Layout(kind).size(8, 20))
    assert (float(frame[0, 0, 0]), float(frame[0, 0, -1])) == (left, right)


def test_side_by_side_shows_the_render_on_the_left():
    frame = Layout("side_by_side")(RENDER, ENHANCED, 0.0)
    assert frame.shape == (3, *Layout("side_by_side").size(8, 20)) == (3, 8, 40)
    assert torch.equal(frame[..., :20], RENDER)
    assert torch.equal(frame[..., 20:], ENHANCED)


def test_a_wipe_divides_the_frame_by_a_line():
    frame = Layout("wipe", 0.3)(RENDER, ENHANCED, 0.0)
    assert frame.shape == (3, 8, 20)
    assert frame[0, 0].tolist() == [0.25] * 5 + [1.0] * 2 + [0.75] * 13
    assert torch.equal(Layout("wipe", 0)(RENDER, ENHANCED, 0.0), ENHANCED)
    assert torch.equal(Layout("wipe", 1)(RENDER, ENHANCED, 0.0), RENDER)


def test_the_line_sweeps_from_side_to_side():
    sweep = Layout("wipe", None)
    assert torch.equal(sweep(RENDER, ENHANCED, 0.0), ENHANCED)
    assert torch.equal(sweep(RENDER, ENHANCED, 0.25), RENDER)
    assert torch.equal(sweep(RENDER, ENHANCED, 0.5), ENHANCED)


def test_what_cannot_be_shown_is_refused():
    with pytest.raises(InputError, match="layout: is 'beside'; choose enhanced, render"):
        Layout("beside")
    with pytest.raises(InputError, match="wipe"):
        Layout("wipe", 2)
    with pytest.raises(InputError, match="was not made"):
        Layout("wipe")(None, ENHANCED, 0.0)
    assert torch.equal(Layout()(None, ENHANCED, 0.0), ENHANCED)
