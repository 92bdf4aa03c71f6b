"""An earlier step's enhanced view is used where both differ and the references decide between them."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool, build_network_input, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.earlier_step import DIFFERENCE, TwoStepEnhancer, combine_with_earlier
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.plan import Rules, ViewPlan
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.super_resolution import limit_finer_scales
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.types import NetworkInput, Region
from support.synthetic_runs import write_plane_run

GREY, OFFSET = 0.5, 0.2
CONFIG = load_weights("lr_tiny").reference_config


def enhancer_of(weights: str, config: ReferenceConfig = CONFIG, *, ensemble: bool = True) -> SetEnhancer:
    pretrained = load_weights(weights)
    return SetEnhancer(
        pretrained.network, config, precision="float32", confidence=pretrained.confidence, ensemble=ensemble
    )


@pytest.fixture(scope="module")
def steps(tmp_path_factory) -> tuple[RenderedSet, RenderedSet]:
    """Two steps of a run, the last of which shows a floater in its right half."""
    folder = write_plane_run(tmp_path_factory.mktemp("runs") / "plane", steps=(4000, 16000))
    earlier, last = (read_run(folder, step) for step in (4000, 16000))
    floater = torch.zeros(48, 64, dtype=torch.bool)
    floater[12:30, 40:56] = True
    targets = tuple(
        replace(view, read=lambda read=view.read: read().masked_fill(floater, 0.35)) for view in last.targets
    )
    return earlier, replace(last, targets=targets)


def network_input(rendered: RenderedSet, index: int, config: ReferenceConfig = CONFIG) -> NetworkInput:
    target = read_target(rendered.targets[index])
    return build_network_input(
        target, config.align(target, rendered.targets[index], ReferencePool(rendered.references))
    )


def grey(value: float = GREY, side: int = 64) -> Tensor:
    return torch.full((3, side, side), value)


def share(enhanced: Tensor, earlier: Tensor, render: Tensor, earlier_render: Tensor) -> Tensor:
    """The share of the earlier view, where both views differ."""
    combined = combine_with_earlier(enhanced, earlier, render, earlier_render)
    return ((combined - enhanced) / (earlier - enhanced)).mean(0)


def test_the_render_that_photos_contradict_less_has_the_larger_share() -> None:
    enhanced, earlier = grey(0.45), grey(0.55)
    worse_last = share(enhanced, earlier, grey(0.2), grey(0.6))
    worse_earlier = share(enhanced, earlier, grey(0.4), grey(0.8))
    assert float(worse_last.min()) > 0.8 > 0.2 > float(worse_earlier.max())


def test_equal_errors_share_equally_where_the_views_differ_clearly() -> None:
    shares = share(grey(0.3), grey(0.7), grey(0.1), grey(0.9))
    difference = 0.4**2
    torch.testing.assert_close(shares, torch.full_like(shares, 0.5 * difference / (difference + DIFFERENCE**2)))


def test_slight_differences_leave_the_view_as_it_is() -> None:
    enhanced, earlier = grey(), grey(GREY + DIFFERENCE / 10)
    shares = share(enhanced, earlier, grey(GREY - OFFSET), grey(GREY + OFFSET))
    assert 0 < float(shares.max()) < 0.01


@pytest.mark.parametrize(("remaining", "full"), [(1.0, 0.0), (0.75, 0.0), (0.625, 0.5), (0.5, 1.0), (0.2, 1.0)])
def test_without_evidence_the_view_stays_as_it_is(remaining, full) -> None:
    """``remaining`` of the renders' squared difference is left after enhancement."""
    half = OFFSET * remaining**0.5
    shares = share(grey(GREY - half), grey(GREY + half), grey(GREY - OFFSET), grey(GREY + OFFSET))
    difference = (2 * half) ** 2
    expected = full * 0.5 * difference / (difference + DIFFERENCE**2)
    torch.testing.assert_close(shares, torch.full_like(shares, expected), atol=2e-3, rtol=0)


def test_regions_are_decided_separately() -> None:
    """In the left half no photo decides, in the right half the last render was wrong."""
    enhanced, earlier, render, earlier_render = (grey(value, 128) for value in (0.4, 0.6, 0.4, 0.6))
    enhanced[..., 64:], earlier[..., 64:] = 0.55, 0.65
    render[..., 64:] = 0.2
    shares = share(enhanced, earlier, render, earlier_render)
    assert float(shares[:, :40].max()) < 1e-6
    assert float(shares[:, 90:].min()) > 0.6


def test_equal_steps_change_nothing() -> None:
    image = torch.rand(3, 40, 50, generator=torch.Generator().manual_seed(0))
    assert torch.equal(combine_with_earlier(image, image, image, image), image)


def test_small_views_are_combined() -> None:
    """Views that are smaller than the windows."""
    shares = share(grey(0.3, 5), grey(0.7, 5), grey(0.1, 5), grey(0.9, 5))
    assert float(shares.min()) > 0.4


def test_both_steps_are_enhanced_with_the_references_of_the_last(steps) -> None:
    earlier, last = steps
    enhancer, single = (enhancer_of("lr_tiny", ensemble=on) for on in (True, False))
    found = list(TwoStepEnhancer(enhancer, earlier.targets)(last))
    assert [view.name for view in found] == [view.name for view in last.targets]
    for i, view in enumerate(found):
        seen, render = network_input(last, i), earlier.targets[i].read()
        enhanced = enhancer.enhance(seen)[0]
        other = single.enhance(replace(seen, render=render[None], reference_renders=None))[0]
        expected = combine_with_earlier(enhanced, other, seen.render[0], render)
        torch.testing.assert_close(view.image, expected, rtol=0, atol=1e-5)
        assert float((expected - enhanced).abs().max()) > 0.02
    again = next(enhancer(last)).image
    torch.testing.assert_close(again, enhancer.enhance(network_input(last, 0))[0], rtol=0, atol=1e-5)


def test_super_resolution_combines_its_first_network_alone(steps) -> None:
    earlier, last = steps
    fine = tuple(
        replace(view, read_fine_photo=lambda view=view: upsample_bicubic(view.read_photo()[None], 4)[0].clamp(0, 1))
        for view in last.references
    )
    last, config = replace(last, references=fine), replace(CONFIG, fine=True)
    enhancer, first_enhancer = (enhancer_of("sr_tiny", config) for _ in range(2))
    cascade = first_enhancer.network
    first_enhancer.network = cascade.first
    first, found = (next(TwoStepEnhancer(one, earlier.targets)(last)).image[None] for one in (first_enhancer, enhancer))
    seen = network_input(last, 0, config)
    with torch.inference_mode():
        finer = limit_finer_scales(cascade.second(replace(seen, render=first)), first, seen)
    torch.testing.assert_close(found, finer.clamp(0, 1), rtol=0, atol=1e-5)


def test_each_region_of_a_plan_has_its_part_of_the_earlier_render(steps) -> None:
    earlier, last = steps
    planner = Planner(Rules(tiles="auto", margin=0), CONFIG, last)
    enhancer = TwoStepEnhancer(enhancer_of("lr_tiny"), earlier.targets)
    regions = Region(0, 0, 48, 32), Region(0, 32, 48, 64)
    images = []
    for order in (regions, regions[::-1]):
        planner.plans = {view.name: ViewPlan(view.name, (48, 64), order) for view in last.targets}
        images.append(next(enhancer(last, planner)).image)
    assert torch.equal(*images)
    alone = next(enhancer_of("lr_tiny")(last, planner)).image
    left, right = (float((region.crop(images[0]) - region.crop(alone)).abs().max()) for region in regions)
    assert right > 0.1 > 5 * left


@pytest.mark.parametrize(("fault", "told"), [("missing", "no render at the earlier step"), ("size", "another size")])
def test_an_earlier_step_with_other_renders_is_refused(steps, fault, told) -> None:
    earlier, last = steps
    first = earlier.targets[0]
    targets = earlier.targets[1:]
    if fault == "size":
        targets = replace(first, read=lambda: first.read()[..., :32]), *targets
    with pytest.raises(InputError, match=told):
        next(TwoStepEnhancer(enhancer_of("lr_tiny"), targets)(last))
