"""The planner: what it leaves out, what it must not leave out, and what that does to the image."""

import dataclasses

import pytest
import torch

from gaussian_enhancer.align.alignment import Unwarped
from gaussian_enhancer.align.references import ReferenceConfig, read_target
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.plan import Rules
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.network.ssif_sr import SSIFSR
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.types import Region
from support.networks import small_sif, trained
from support.projection import project
from support.synthetic_runs import plane_camera, plane_view

AUTO = Rules("auto", "auto", "auto")
SIZE = (96, 128)
TEXTURE = torch.rand(3, 192, 192, generator=torch.Generator().manual_seed(0))


def thing(index: int, *, painted: bool = False) -> RenderedView:
    """A textured card on white as one of its renders and photos; ``painted``: its photo has a mark on the white."""
    camera = plane_camera(index, *SIZE)
    photo, depth = plane_view(camera, TEXTURE)
    column, row = map(int, project(camera, torch.tensor([0.0, 0.0, 3.0])))
    mask = torch.zeros(1, *SIZE)
    mask[:, max(0, row - 14) : row + 14, max(0, column - 22) : column + 22] = 1
    photo = photo * mask + (1 - mask)
    render = (0.9 * photo + 0.05).clamp(0, 1) * mask + (1 - mask)
    if painted:
        photo = photo.clone()
        photo[:, row + 28 : row + 40, column - 10 : column + 10] = 0.88  # little enough to be believed
    alpha = torch.ones_like(mask)
    return RenderedView(f"{index}.png", lambda: render, camera, lambda: depth, lambda: alpha, lambda: photo, None)


def things(*references: RenderedView) -> RenderedSet:
    return RenderedSet("card", (thing(0),), references or (thing(1), thing(2)), (1.0, 1.0, 1.0))


def behind(index: int) -> RenderedView:
    """A reference that looks the other way."""
    view = thing(index)
    assert view.camera is not None
    turned = view.camera.world_to_camera.clone()
    turned[:3, :3] = torch.diag(torch.tensor([-1.0, 1.0, -1.0]))
    return dataclasses.replace(view, camera=dataclasses.replace(view.camera, world_to_camera=turned))


def planned(rendered: RenderedSet, rules: Rules = AUTO, reference_config: ReferenceConfig | None = None):
    planner = Planner(rules, reference_config or ReferenceConfig(), rendered)
    view = rendered.targets[0]
    return planner(view, read_target(view)), planner


def test_background_is_passed_through_bit_for_bit_and_the_rest_is_enhanced():
    rendered, network = things(), trained()
    plan, planner = planned(rendered)
    assert plan.regions is not None
    assert 0.5 < plan.passed_share < 0.9
    enhancer = SetEnhancer(network, ReferenceConfig(), precision="float32")
    (part,), (full,) = list(enhancer(rendered, planner)), list(enhancer(rendered))
    render = rendered.targets[0].read()  # type: ignore[misc]
    inside = torch.zeros(SIZE, dtype=torch.bool)
    for region in plan.regions:
        region.crop(inside).fill_(True)
    assert torch.equal(part.image[:, ~inside], render[:, ~inside])
    assert not torch.equal(full.image[:, ~inside], render[:, ~inside])
    change = (full.image - render)[:, inside].abs().mean()
    assert (part.image - render)[:, inside].abs().mean() > 0.5 * change
    assert part.plan == plan
    assert torch.equal(render, thing(0).read())  # type: ignore[misc]


def test_an_untrained_network_returns_the_render_whatever_is_left_out():
    rendered = things()
    render = rendered.targets[0].read()  # type: ignore[misc]
    _, planner = planned(rendered)
    (one,) = SetEnhancer(small_sif(), ReferenceConfig())(rendered, planner)
    assert torch.equal(one.image, render)
    (fine,) = SetEnhancer(SSIFSR((8, 8, 8), (1, 1, 1)), ReferenceConfig(), precision="float32")(rendered, planner)
    expected = upsample_bicubic(render[None], 4)[0].clamp(0, 1)
    inner = torch.nn.functional.max_pool2d((render != 1).any(0).float()[None], 9, 1, 4)[0] == 0
    flat = inner.repeat_interleave(4, 0).repeat_interleave(4, 1)
    assert torch.equal(fine.image[:, flat], expected[:, flat])
    torch.testing.assert_close(fine.image, expected, atol=0.2, rtol=0)


def test_where_a_reference_shows_more_than_the_background_nothing_is_passed_through():
    bare, _ = planned(things())
    more, _ = planned(things(thing(1, painted=True), thing(2)))
    assert bare.regions is not None
    bottom = max(region.bottom for region in bare.regions)
    assert bottom == 80
    assert more.regions is None or max(region.bottom for region in more.regions) > bottom


def test_an_image_without_background_is_enhanced_whole():
    rendered = things()
    black = dataclasses.replace(rendered, background=(0.0, 0.0, 0.0))
    assert planned(black)[0].regions is None
    assert planned(rendered, dataclasses.replace(AUTO, tiles="all"))[0].regions is None
    nothing = dataclasses.replace(thing(0), read=lambda: torch.ones(3, *SIZE))
    empty = RenderedSet("white", (nothing,), (), (1.0, 1.0, 1.0))
    plan, planner = planned(empty, reference_config=ReferenceConfig(references=0))
    assert (plan.regions, plan.passed_share) == ((), 1.0)
    (one,) = SetEnhancer(trained(), ReferenceConfig(references=0))(empty, planner)
    assert torch.equal(one.image, torch.ones(3, *SIZE))


def test_references_that_see_nothing_are_left_out_with_their_share():
    plan, planner = planned(things(behind(1), thing(2), thing(4)))
    assert set(plan.references or ()) == {"2.png", "4.png"}
    assert plan.left_out == {"1.png": 0.0}
    assert {planner.index[name] for name in plan.references or ()} == set(planner.reference_indices(plan) or ())
    (one,) = SetEnhancer(trained(), ReferenceConfig())(things(behind(1), thing(2), thing(4)), planner)
    assert set(one.references) == {"2.png", "4.png"}
    every, _ = planned(things(behind(1), thing(2)), dataclasses.replace(AUTO, references="all"))
    assert (every.references, every.left_out) == (None, {})


def test_no_more_references_are_warped_than_are_kept():
    reference_config = ReferenceConfig(references=1, candidates=3)
    plan, _ = planned(things(thing(1), thing(2), thing(4)), reference_config=reference_config)
    assert len(plan.references or ()) == 1
    assert len(plan.left_out) == 2
    assert min(plan.left_out.values()) > 0.5


def test_references_that_are_not_warped_belong_to_the_whole_image():
    plan, planner = planned(things(), reference_config=ReferenceConfig(Unwarped()))
    assert (plan.regions, planner.reference_indices(plan)) == (None, None)


@pytest.mark.parametrize("make", [small_sif, trained])
def test_rules_that_leave_nothing_out_change_no_bit(make):
    rendered = things()
    enhancer = SetEnhancer(make(), ReferenceConfig())
    planner = Planner(Rules(), enhancer.reference_config, rendered)
    (with_rules,), (without,) = list(enhancer(rendered, planner)), list(enhancer(rendered))
    assert torch.equal(with_rules.image, without.image)
    assert with_rules.references == without.references


def test_views_that_were_decided_before_are_not_decided_again():
    rendered = things()
    before = dataclasses.replace(planned(rendered)[0], regions=(Region(0, 0, 16, 16),))
    planner = Planner(AUTO, ReferenceConfig(), rendered, [before])
    assert planner(rendered.targets[0], read_target(rendered.targets[0])) is before


def test_candidates_of_small_views_are_looked_at_only_where_background_is_left_out():
    small = dataclasses.replace(AUTO, small=SIZE[0] * SIZE[1])
    looked, _ = planned(things(), small)
    assert looked.regions is not None
    assert looked.references is not None
    everything = dataclasses.replace(small, tiles="all")
    plan, planner = planned(things(), everything)
    assert (plan.references, plan.regions, plan.left_out) == (None, None, {})
    assert planner.reference_indices(plan) is None
    larger, _ = planned(things(), dataclasses.replace(everything, small=SIZE[0] * SIZE[1] - 1))
    assert larger.references is not None
