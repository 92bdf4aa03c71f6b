"""Choices, stages and what cameras see, on the plane's run."""

import dataclasses

import pytest
import torch

from gaussian_enhancer.align.references import read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.high_resolution import attach_fine_photos
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.types import Camera, identity_camera
from gaussian_enhancer.viewer.cameras import PageCamera
from gaussian_enhancer.viewer.session import STAGE_CACHE_SIZE
from gaussian_enhancer.viewer.source import CONFIGURED_PLAN, DISTILLED, RAW, open_session
from gaussian_enhancer.viewer.stage import StageView
from support.synthetic_runs import copy_with_black_photos

CPU = torch.device("cpu")


def looking(z: float, turned: bool = False) -> Camera:
    """A camera on the plane's axis at a depth, the plane being at 3; turned, it looks away."""
    camera = identity_camera(48, 64, 64.0)
    pose = torch.eye(4)
    pose[2, 3] = -z
    if turned:
        pose = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0])) @ pose
    return Camera(camera.K, pose, 48, 64)


def drawn(session, camera, choice=None, **how) -> StageView:
    view = session.draw(session.initial_choice if choice is None else choice, camera, **how)
    assert view is not None
    return view


def test_a_view_is_rendered_and_enhanced_by_the_share_of_the_weights_card(session):
    view = drawn(session, looking(0.0))
    assert view.enhanced is not None
    assert view.render.shape == view.enhanced.shape == (3, 48, 64)
    inner = (view.enhanced < 1) & (view.enhanced > 0)
    half = (view.enhanced - view.render)[inner]
    full = drawn(session, looking(0.0), dataclasses.replace(session.initial_choice, strength=1.0))
    assert full.enhanced is not None
    full_change = (full.enhanced - full.render)[inner]
    assert float(half.mean()) == pytest.approx(float(full_change.mean()) / 2, rel=0.1)
    assert float(half.mean()) > 0.01
    assert session.strength(session.initial_choice) == 0.5
    assert 1 <= len(view.references) <= 3
    assert view.times.total == view.times.rendering + view.times.preparing + view.times.enhancing
    assert not view.blank


def test_coverage_is_the_share_of_the_photos_that_show_a_pixel(session):
    camera = looking(0.0)
    view, stage = drawn(session, camera), session.stage(session.initial_choice)
    config = stage.enhancer.reference_config
    target = stage.make_target("again.png", camera)
    aligned = config.align(read_target(target), target, stage.pool)
    assert view.coverage is not None
    torch.testing.assert_close(view.coverage, (aligned.visibility.sum(0) / 3).clamp(0, 1))
    assert 0 < float(view.coverage.mean()) <= 1


def test_the_network_is_left_out_where_it_is_not_needed(session, monkeypatch):
    stage = session.stage(session.initial_choice)
    monkeypatch.setattr(type(stage.enhancer), "enhance", lambda *_: pytest.fail("the network ran"))
    view = drawn(session, looking(0.0), enhance=False)
    assert view.enhanced is view.coverage is None
    assert view.times.enhancing == 0
    assert session.draw(session.initial_choice, looking(0.0), superseded=lambda: True) is None


@pytest.mark.parametrize("camera", [looking(3.0), looking(2.9999), looking(0.0, turned=True), looking(1e6)])
def test_a_camera_within_the_wall_or_past_it_gives_a_picture(session, camera):
    view = drawn(session, camera)
    assert view.enhanced is not None
    assert bool(torch.isfinite(view.enhanced).all())
    assert bool(torch.isfinite(view.render).all())


def test_a_camera_that_looks_away_sees_nothing_and_changes_nothing(session):
    view = drawn(session, looking(0.0, turned=True))
    assert view.blank
    assert view.references == () or float(view.coverage.max()) == 0
    assert torch.equal(view.enhanced, view.render)


def test_the_nearest_photo_is_that_of_its_own_camera(session):
    stage = session.stage(session.initial_choice)
    for view in stage.pool.views:
        photo = stage.nearest_photo(PageCamera.of(view.camera).to_camera(64))
        assert photo is not None
        assert photo.name == view.name


def test_plans_of_past_views_are_forgotten(session):
    for _ in range(3):
        drawn(session, looking(0.0))
    planner = session.stage(session.initial_choice).planner
    assert planner is not None
    assert not planner.plans


def test_the_number_of_references_is_chosen(session):
    view = drawn(session, looking(0.0), dataclasses.replace(session.initial_choice, max_references=1))
    assert len(view.references) == 1
    none = drawn(session, looking(0.0), dataclasses.replace(session.initial_choice, max_references=0))
    assert none.references == ()


def test_stages_are_kept_and_the_oldest_is_dropped(session):
    first = session.stage(session.initial_choice)
    assert session.stage(dataclasses.replace(session.initial_choice, strength=0.1)) is first
    assert first.enhancer.strength == 0.1
    assert session.strength(session.initial_choice) == 0.5
    others = [dataclasses.replace(session.initial_choice, max_references=count) for count in range(STAGE_CACHE_SIZE)]
    for choice in others:
        session.stage(choice)
    assert session.stage(others[-1]) is session.stage(others[-1])
    assert session.stage(session.initial_choice) is not first


def test_another_splat_of_the_same_capture_brings_its_own_renders(configured, viewed):
    session = open_session(configured(f"distilled={viewed / 'distilled.ply'}"), CPU, print)
    assert session.choices.splats == (RAW, DISTILLED)
    assert session.initial_choice.splat == DISTILLED
    assert open_session(configured(f"distilled={viewed}"), CPU, print).choices.splats == (RAW, DISTILLED)
    raw = dataclasses.replace(session.initial_choice, splat=RAW)
    distilled_view, raw_view = drawn(session, looking(0.0)), drawn(session, looking(0.0), raw)
    assert float((distilled_view.render - raw_view.render).abs().mean()) > 0.01
    renders = [session.stage(choice).pool.read(0).render for choice in (session.initial_choice, raw)]
    assert float((renders[0] - renders[1]).abs().mean()) > 0.01
    assert torch.equal(*(session.stage(choice).pool.read(0).image for choice in (session.initial_choice, raw)))


def test_what_is_offered(configured):
    session = open_session(configured("plan.margin=8", "strength=0.25", "max_references=2"), CPU, print)
    assert list(session.choices.plans) == [CONFIGURED_PLAN, "auto", "full"]
    assert session.choices.plans[CONFIGURED_PLAN].margin == 8
    assert session.initial_choice.strength == session.strength(session.initial_choice) == 0.25
    assert session.initial_choice.max_references == 2
    assert set(session.choices.weights) >= {"lr_tiny", "sr_tiny", session.initial_choice.weights}
    assert list(open_session(configured("plan=full"), CPU, print).choices.plans) == ["full", "auto"]


def test_super_resolution_shows_a_picture_of_the_same_size(configured):
    session = open_session(configured("weights=sr_tiny"), CPU, print)
    view = drawn(session, looking(0.0).resized(96, 128))
    assert view.render.shape == (3, 24, 32)
    assert view.enhanced is not None
    assert view.enhanced.shape == (3, 96, 128)


def test_super_resolution_reads_the_fine_photos_of_the_capture(configured, monkeypatch):
    def attach(_, rendered: RenderedSet) -> RenderedSet:
        cameras = [view.camera.resized(4 * view.camera.height, 4 * view.camera.width) for view in rendered.references]
        named = zip(rendered.references, cameras, strict=True)
        photos = [Photo(view.name, camera, lambda: torch.rand(3, 192, 256)) for view, camera in named]
        return attach_fine_photos(rendered, Scene("fine", tuple(photos), tuple(range(len(photos))), ()))

    monkeypatch.setattr("gaussian_enhancer.viewer.source.attach_fine", attach)
    session = open_session(configured("weights=sr_tiny"), CPU, print)
    views = session.stage(session.initial_choice).pool.views
    assert views
    assert all(view.read_fine_photo is not None for view in views)


def test_what_is_wrong_with_the_photos_is_said_once(configured, viewed, tmp_path):
    notes: list[str] = []
    session = open_session(configured("weights=sr_tiny"), CPU, notes.append)
    session.stage(dataclasses.replace(session.initial_choice, plan="full"))
    assert len(notes) == 1
    assert notes[0].startswith("raw: ")
    assert "config.yaml: does not exist" in notes[0]
    notes.clear()
    open_session(configured(f"run={copy_with_black_photos(viewed, tmp_path / 'other')}"), CPU, notes.append)
    assert len(notes) == 1
    assert "raw: the splat's renders are unlike their photos" in notes[0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run=null"], "view: was given nothing to render; give one of run="),
        (["gaussians=a.ply"], "was given run and gaussians"),
        (["distilled=none_such.ply"], "none_such.ply"),
        (["weights=none_such"], "is neither a file nor a shipped name"),
        (["strength=2"], "strength: is 2"),
        (["max_references=9"], "references: is 9"),
        (["method=4dgs"], "4dgs"),
    ],
)
def test_what_cannot_be_used_is_refused_before_a_page_is_served(configured, words, message):
    with pytest.raises(InputError, match=message):
        open_session(configured(*words), CPU, print)
