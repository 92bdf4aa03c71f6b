"""What of the input is used: depth that is none is found out, and everything left out has its reason."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from test_planner import AUTO, TEXTURE, things

from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.plan import Rules
from gaussian_enhancer.infer.validated_inputs import depth_mismatch_reason, validate_inputs
from gaussian_enhancer.scene.depth_files import ReadDepth
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from support.synthetic_runs import plane_camera


def slanted(index: int, change=lambda z: z) -> RenderedView:
    """A view of two textured planes, the right one twice as far, with its depth as ``change`` makes it."""
    camera = plane_camera(index, 96, 128)
    y, x = torch.meshgrid(torch.arange(96) + 0.5, torch.arange(128) + 0.5, indexing="ij")
    rays = torch.linalg.inv(camera.K) @ torch.stack([x, y, torch.ones_like(x)]).flatten(1)
    near, far = (z - camera.centre[2] for z in (3.0, 7.0))
    points = camera.centre[:, None] + rays * near
    left = (points[0] < 0).view(96, 128)
    depth = torch.where(left, near, far)[None]
    points = camera.centre[:, None] + rays * depth.flatten()
    grid = (points[:2].T / 4).view(1, 96, 128, 2)
    smooth = torch.nn.functional.avg_pool2d(TEXTURE[None], 9, 1, 4)
    smooth = (smooth - 0.5) * 4 + 0.5
    photo = torch.nn.functional.grid_sample(smooth, grid, align_corners=False, padding_mode="reflection")[0].clamp(0, 1)
    given = change(depth)
    return RenderedView(f"{index}.png", lambda: photo, camera, lambda: given, None, lambda: photo)


def scene(change=lambda z: z) -> RenderedSet:
    return RenderedSet("planes", (slanted(0, change), slanted(5, change)), (slanted(1), slanted(2), slanted(6)))


def test_true_depth_is_not_doubted():
    assert depth_mismatch_reason(ReferencePool(scene().references), ReferenceConfig(), scene().targets) == ""
    near = scene(lambda z: z * 1.02)
    assert depth_mismatch_reason(ReferencePool(near.references), ReferenceConfig(), near.targets) == ""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda z: z * 2, "0.5 times as deep"),
        (lambda z: z / 2, "2 times as deep"),
        (lambda z: z / 10, "10 times as deep"),
        (lambda z: z * 100, "times as deep"),
        (lambda z: z * 1000, "0.001 times as deep"),
        (lambda z: z / 1000, "times as deep"),
        (lambda z: 12 / z, "a flat plane|times as deep"),
        (torch.zeros_like, "no finite positive value"),
        (lambda z: z * torch.nan, "no finite positive value"),
    ],
)
def test_depth_of_another_scale_or_kind_is_found_out(change, words):
    wrong = scene(change)
    assert re.search(words, depth_mismatch_reason(ReferencePool(wrong.references), ReferenceConfig(), wrong.targets))


def test_a_view_into_the_void_is_no_reason_to_doubt_the_depth_of_others():
    rendered = scene()
    void = replace(rendered.targets[0], read_depth=lambda: torch.zeros(1, 96, 128))
    targets = (void, rendered.targets[1])
    assert depth_mismatch_reason(ReferencePool(rendered.references), ReferenceConfig(), targets) == ""


def test_depth_is_not_judged_by_the_only_photo_if_it_is_the_views_own():
    own = ReferencePool((slanted(0),))
    assert depth_mismatch_reason(own, ReferenceConfig(), (slanted(0, lambda z: z * 2),)) == ""


def test_a_reference_from_the_views_own_place_does_not_speak_for_another_depth():
    rendered = scene()
    twin = replace(slanted(0), name="twin.png")
    pool = ReferencePool((twin, slanted(6)))
    assert depth_mismatch_reason(pool, ReferenceConfig(), rendered.targets[:1]) == ""


def test_one_view_that_fits_is_enough_and_no_other_is_read():
    def unread() -> torch.Tensor:
        raise AssertionError("read")

    first, second = scene().targets
    assert (
        depth_mismatch_reason(
            ReferencePool(scene().references), ReferenceConfig(), (first, replace(second, read=unread))
        )
        == ""
    )


def test_depth_files_are_doubted_unless_they_are_our_own(tmp_path):
    for index in (0, 5):
        np.save(tmp_path / f"{index}.npy", slanted(index, lambda z: z * 2).read_depth()[0].numpy())
    kept = [replace(slanted(i), read_depth=ReadDepth(tmp_path / f"{i}.npy")) for i in (0, 5)]
    rendered = replace(scene(), targets=tuple(kept))
    assert not part(validate_inputs(rendered, ReferenceConfig(), AUTO).parts, "depth").used
    assert part(validate_inputs(replace(rendered, own_depth=True), ReferenceConfig(), AUTO).parts, "depth").used
    assert part(validate_inputs(rendered, ReferenceConfig(), Rules()).parts, "depth").used


def test_references_that_were_looked_at_stay_in_memory(tmp_path):
    reads = []

    def counted(view: RenderedView) -> RenderedView:
        def read() -> torch.Tensor:
            reads.append(view.name)
            return view.read_photo()

        return replace(view, read_photo=read)

    np.save(tmp_path / "0.npy", slanted(0).read_depth()[0].numpy())
    target = replace(slanted(0), read_depth=ReadDepth(tmp_path / "0.npy"))
    rendered = RenderedSet("planes", (target,), tuple(counted(slanted(i)) for i in (1, 2, 6)))
    found = validate_inputs(rendered, ReferenceConfig(), AUTO)
    looked_at = sorted(reads)
    assert len(looked_at) == 2
    ReferenceConfig().align(read_target(target), target, found.pool)
    assert sorted(reads) == ["1.png", "2.png", "6.png"]
    without = validate_inputs(rendered, ReferenceConfig(), replace(AUTO, depth="none"))
    assert without.pool.views == without.rendered.references
    assert all(view.read_depth is None for view in without.pool.views)


@pytest.mark.parametrize("bare", ["targets", "references"])
def test_depth_is_not_judged_without_cameras(bare):
    wrong = scene(lambda z: z * 2)
    views = getattr(wrong, bare)
    unplaced = replace(wrong, **{bare: (replace(views[0], camera=None), *views[1:])})
    assert depth_mismatch_reason(ReferencePool(unplaced.references), ReferenceConfig(), unplaced.targets[:1]) == ""


def part(parts, name):
    return next(one for one in parts if one.name == name)


def test_everything_is_used_where_everything_is_there():
    rendered = things()
    found = validate_inputs(rendered, ReferenceConfig(), AUTO)
    assert (found.rendered, found.reference_config, found.missing_references) == (rendered, ReferenceConfig(), ())
    assert {one.name: one.used for one in found.parts} == {
        "super-resolution": False,
        "cameras": True,
        "depth": True,
        "references": True,
    }
    assert part(validate_inputs(rendered, ReferenceConfig(), AUTO, scale=4).parts, "super-resolution").used


def test_depth_that_is_switched_off_takes_the_references_along():
    found = validate_inputs(things(), ReferenceConfig(), replace(AUTO, depth="none"))
    assert found.reference_config.references == 0
    assert all(view.read_depth is None for view in (*found.rendered.targets, *found.rendered.references))
    assert part(found.parts, "depth").why == "switched off"
    assert found.missing_references == (
        "depth is switched off, so that photos cannot be reprojected: no photo is used",
    )


def test_references_give_refused_depth_as_their_reason():
    found = validate_inputs(scene(lambda z: 2 * z), ReferenceConfig(fine=True), AUTO, scale=4)
    assert [one.name for one in found.parts if one.used] == ["super-resolution", "cameras"]
    assert part(found.parts, "references").why.startswith(part(found.parts, "depth").why + ", so that photos")


@pytest.mark.parametrize("fine", [False, True])
def test_a_plan_without_references_says_that_none_were_asked_for(fine):
    rendered = things()
    rendered = replace(rendered, references=(replace(rendered.references[0], camera=None), *rendered.references[1:]))
    found = validate_inputs(rendered, ReferenceConfig(references=0, fine=fine), AUTO)
    assert not part(found.parts, "references").used
    assert part(found.parts, "references").why == "none are asked for: views are enhanced from their renders alone"
    assert "fine photos" not in {one.name for one in found.parts}
    assert found.missing_references == ()


def test_references_without_the_camera_that_others_have_are_left_out_by_auto_alone():
    rendered = things()
    bare = replace(rendered.references[0], camera=None)
    mixed = replace(rendered, references=(bare, *rendered.references[1:]))
    found = validate_inputs(mixed, ReferenceConfig(), AUTO)
    assert [view.name for view in found.rendered.references] == ["2.png"]
    assert found.reference_config.references == 3
    assert "1 without a camera left out, 1.png" in part(found.parts, "references").why
    full = validate_inputs(mixed, ReferenceConfig(), Rules())
    assert full.reference_config.references == 0
    assert "1.png has no camera" in full.missing_references[0]


def test_fine_photos_are_not_asked_for_where_they_are_not_known():
    found = validate_inputs(things(), ReferenceConfig(fine=True), AUTO, scale=4)
    assert not found.reference_config.fine
    assert "super-resolution without their detail" in found.missing_references[0]


def test_references_are_refused_where_there_are_none():
    with pytest.raises(InputError, match="no photo to refer to"):
        validate_inputs(replace(things(), references=()), ReferenceConfig(), AUTO)
    assert (
        validate_inputs(replace(things(), references=()), ReferenceConfig(references=0), AUTO).missing_references == ()
    )
