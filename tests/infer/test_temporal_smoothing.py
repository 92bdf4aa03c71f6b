"""Changes carried along a path: mixed where both frames show one surface, and nowhere else."""

import dataclasses

import pytest
import torch

from gaussian_enhancer.align.alignment import LoadedView
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.temporal_smoothing import smooth_change
from gaussian_enhancer.network.ssif_sr import SSIFSR
from gaussian_enhancer.scene.renders import read_run
from support.networks import small_sif, trained
from support.synthetic_runs import plane_camera, plane_view


def frame(index: int) -> LoadedView:
    camera = plane_camera(index, 48, 64)
    image, depth = plane_view(camera, torch.rand(3, 40, 40, generator=torch.Generator().manual_seed(0)))
    return LoadedView(f"{index}.png", 0.25 + image / 2, camera, depth, torch.ones_like(depth))


def test_a_standing_camera_averages_the_changes():
    target = frame(0)
    first, before = smooth_change(target.image + 0.1, target, None, 0.6)
    torch.testing.assert_close(first, target.image + 0.1)
    second, _ = smooth_change(target.image - 0.1, target, before, 0.6)
    torch.testing.assert_close(second, target.image + 0.4 * -0.1 + 0.6 * 0.1, rtol=0, atol=1e-5)


def test_a_change_follows_the_surface():
    here, there = frame(0), frame(1)
    marked = here.image.clone()
    marked[:, 20:28, 28:36] += 0.2
    _, before = smooth_change(marked, here, None, 0.5)
    found, _ = smooth_change(there.image, there, before, 0.5)
    change = (found - there.image).mean(0)
    assert change.max() == pytest.approx(0.1, abs=1e-3)
    across = (change.sum(0) * torch.arange(64)).sum() / change.sum()
    # The camera moves by 0.15 before a plane at 3: 64 px of focal length x 0.15 / 3 is 3.2 px.
    assert across == pytest.approx(31.5 - 3.2, abs=0.3)


def test_what_only_one_frame_shows_is_left_alone():
    target = frame(0)
    assert target.depth is not None
    _, before = smooth_change(target.image + 0.1, target, None, 0.5)
    nearer = dataclasses.replace(target, depth=target.depth / 2)
    found, _ = smooth_change(nearer.image, nearer, before, 0.5)
    torch.testing.assert_close(found, nearer.image)


@pytest.mark.parametrize("lacking", ["camera", "depth"])
def test_what_is_needed_is_named(lacking):
    target = dataclasses.replace(frame(0), **{lacking: None})
    with pytest.raises(InputError, match=f"no {lacking}.*temporal_smoothing=0"):
        smooth_change(target.image, target, None, 0.5)


def test_frames_of_a_run_are_steadied_in_their_order(plane_run):
    rendered = read_run(plane_run)
    each = [one.image for one in SetEnhancer(small_sif(), ReferenceConfig(), temporal_smoothing=0.0)(rendered)]
    both = [one.image for one in SetEnhancer(small_sif(), ReferenceConfig(), temporal_smoothing=0.5)(rendered)]
    assert all(torch.equal(a, b) for a, b in zip(each, both, strict=True))  # untrained: there is no change to carry


def test_a_smoothed_frame_is_not_passed_through(plane_run):
    """The second frame is one that the splat was fitted to; its render takes over a share of the first one's change."""
    rendered = read_run(plane_run)
    own, held_out = rendered.references[0], rendered.targets[0]
    drawn = (own.read_photo() + 0.01).clamp(0, 1)
    fitted = dataclasses.replace(held_out, name=own.name, camera=own.camera, read=lambda: drawn)
    frames = dataclasses.replace(rendered, targets=(held_out, fitted))
    network = trained()
    for smoothing, unchanged in ((0.0, True), (0.5, False)):
        enhancer = SetEnhancer(network, ReferenceConfig(), colour_clamping=0, temporal_smoothing=smoothing)
        _, second = enhancer(frames)
        assert second.unchanged is unchanged
        assert torch.equal(second.image, drawn) is unchanged


@pytest.mark.parametrize("temporal_smoothing", [-0.1, 1.0])
def test_shares_out_of_range_are_refused(temporal_smoothing):
    with pytest.raises(InputError, match="temporal_smoothing"):
        SetEnhancer(small_sif(), ReferenceConfig(), temporal_smoothing=temporal_smoothing)


def test_super_resolution_is_refused():
    network = SSIFSR(widths=(8, 8), blocks=(1, 1))
    with pytest.raises(InputError, match="own resolution"):
        SetEnhancer(network, ReferenceConfig(), temporal_smoothing=0.5)
