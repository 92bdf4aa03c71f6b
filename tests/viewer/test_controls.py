"""The panel beside the picture, without a browser: viser's server keeps the values."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.viewer.controls import Controls, status
from gaussian_enhancer.viewer.modes import Mode
from gaussian_enhancer.viewer.stage import StageView, Times

viser = pytest.importorskip("viser", reason="viser is in the dependency group `test`")


@pytest.fixture
def server() -> Iterator[Any]:
    served = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield served
    served.stop()


def view(**changes: Any) -> StageView:
    render = torch.full((3, 8, 20), 0.5)
    default_view = StageView(
        render, torch.ones(1, 8, 20), torch.ones(1, 8, 20), render,
        torch.ones(1, 8, 20), ("a.png",), Times(10.0, 20.0, 30.4),
    )  # fmt: skip
    return dataclasses.replace(default_view, **changes)


def test_the_panel_begins_with_what_was_given_and_follows_what_is_chosen(server, session):
    changes = []
    controls = Controls(server, session, Mode("wipe", 0.25), lambda: changes.append(1))
    assert controls.mode == Mode("wipe", 0.25)
    assert controls.choice == dataclasses.replace(session.initial_choice, strength=0.5)
    controls._mode.value = "side by side"
    controls._references.value = "2"
    controls.strength.value = 0.1
    assert controls.mode.name == "side_by_side"
    assert (controls.choice.max_references, controls.choice.strength) == (2, 0.1)
    assert len(changes) == 3


def test_a_browser_cannot_ask_for_what_is_not_offered(server, session):
    controls = Controls(server, session, Mode(), lambda: None)
    controls._weights.value = "/etc/passwd"
    with pytest.raises(InputError, match="the page: asks for '/etc/passwd'; choose what it offers"):
        _ = controls.choice
    controls._mode.value = "normals"
    with pytest.raises(InputError, match="show: is 'normals'"):
        _ = controls.mode


def test_the_line_says_what_a_picture_took_and_what_is_missing():
    text = status(7, torch.zeros(3, 8, 40), view(), Mode("side_by_side"))
    assert text.startswith("**60 ms** (render 10, references 20, network 30), 40 × 8, frame 7")
    assert "Render left" in text
    unenhanced_text = status(1, torch.zeros(3, 8, 20), view(enhanced=None, times=Times(10.0)), Mode("render"))
    assert unenhanced_text == "**10 ms** (render 10), 20 × 8, frame 1"
    assert "No photo is used here." in status(1, torch.zeros(3, 8, 20), view(references=()), Mode())
    assert "The splat is not visible" in status(1, torch.zeros(3, 8, 20), view(depth=torch.zeros(1, 8, 20)), Mode())
