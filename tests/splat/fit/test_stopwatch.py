"""Time by phase: the renderer's parts are found where they are, and put back."""

import importlib

import pytest
import torch

from gaussian_enhancer.splat.fit.stopwatch import RENDER_PARTS, Stopwatch
from gaussian_enhancer.splat.methods import ThreeDGS, TwoDGS
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.types import Gaussians, identity_camera


@pytest.mark.parametrize("method", [ThreeDGS(), TwoDGS()], ids=lambda m: m.name)
def test_every_part_of_a_step_is_timed(method):
    axes = 2 if method.name == "2dgs" else 3
    means = torch.tensor([[0.0, 0.0, 5.0], [0.3, 0.1, 4.0]]).requires_grad_()
    scales, quaternions = torch.full((2, axes), -2.0), torch.tensor([[1.0, 0.0, 0.0, 0.0]] * 2)
    gaussians = Gaussians(means, scales, quaternions, torch.zeros(2), torch.ones(2, 1, 3))
    watch = Stopwatch(True)
    with watch.time_render_parts():
        render(gaussians, identity_camera(16, 16, 16.0), method).colour.sum().backward()
    assert set(watch.seconds) == set(RENDER_PARTS)
    assert all(name in watch.table() for name in RENDER_PARTS)
    module = importlib.import_module("gaussian_enhancer.splat.tiles")
    assert module.bin_tiles.__name__ == "bin_tiles"


def test_a_stopwatch_that_is_off_takes_no_time():
    watch = Stopwatch()
    with watch.time_render_parts(), watch.phase("loss"):
        pass
    assert not watch.seconds
