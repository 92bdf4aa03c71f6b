"""What differs from photo to photo in a procedural capture that is not perfect."""

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.procedural import procedural_scene
from gaussian_enhancer.scene.procedural.imperfections import Imperfections
from gaussian_enhancer.scene.procedural.source import _bake_cached
from gaussian_enhancer.scene.stored import scene_from_values
from support.projection import project

SIZE = {"height": 48, "width": 64, "views": 12, "points": 0}
SEED = 3
WHOLE = Imperfections(exposure=0.3, white_balance=0.2, pose=1.0, wind=0.05)


def photos(imperfections: Imperfections | None):
    return procedural_scene("object", SEED, **SIZE, imperfections=imperfections).photos


def test_none_and_zeros_change_nothing():
    for plain, zero in zip(photos(None)[:3], photos(Imperfections())[:3], strict=True):
        torch.testing.assert_close(zero.read(), plain.read(), atol=1e-6, rtol=0)
        assert torch.equal(zero.camera.world_to_camera, plain.camera.world_to_camera)


def test_exposure_and_white_balance_are_of_a_photo_and_leave_the_background_white():
    plain, exposed = photos(None), photos(Imperfections(exposure=0.3, white_balance=0.2))
    ratios = []
    for before, after in zip(plain[:4], exposed[:4], strict=True):
        whole = before.read_alpha()[0] == 1
        ratios.append(after.read()[:, whole].mean(1) / before.read()[:, whole].mean(1))
        empty = before.read_alpha()[0] == 0
        assert (after.read()[:, empty] == 1).all()
        assert torch.equal(after.read_depth(), before.read_depth())
    spread = torch.stack(ratios)
    assert spread.std(0).min() > 0.01  # from photo to photo
    assert spread.std(1).max() > 0.005  # from channel to channel


def test_stated_poses_are_off_by_pixels_and_photos_are_those_of_the_true_ones():
    plain, moved = photos(None), photos(Imperfections(pose=1.0))
    assert torch.equal(moved[2].read(), plain[2].read())
    offsets = []
    for before, after in zip(plain, moved, strict=True):
        target = torch.tensor([0.0, 0.0, 0.5])
        pixels = [project(camera, target) for camera in (before.camera, after.camera)]
        offsets.append(float((pixels[1] - pixels[0]).norm()) * 256 / 64)
        rotation = after.camera.rotation.double()
        torch.testing.assert_close(rotation @ rotation.T, torch.eye(3).double(), atol=1e-5, rtol=0)
    assert 0.3 < sum(offsets) / len(offsets) < 3.0


def test_wind_moves_leaves_alone_and_each_photo_its_own_way():
    world = _bake_cached("object", SEED, "cpu")[0]
    assert world.mesh.cutout.any()
    generators = [torch.Generator().manual_seed(k) for k in (0, 1)]
    moved = [
        Imperfections(wind=0.05).draw_deviation(one).apply_to(world).mesh.corners - world.mesh.corners
        for one in generators
    ]
    for shift in moved:
        assert shift[~world.mesh.cutout].abs().max() == 0
        assert 0.005 < shift[world.mesh.cutout].abs().mean() < 0.1
        assert (shift[:, 0] - shift[:, 1]).abs().max() < 1e-5  # a leaf moves as one
    assert (moved[0] - moved[1]).abs().max() > 0.01


def test_the_same_seed_gives_the_same_capture():
    first, again = photos(WHOLE)[5], photos(WHOLE)[5]
    assert torch.equal(first.read(), again.read())
    assert torch.equal(first.camera.world_to_camera, again.camera.world_to_camera)


def test_a_stored_configuration_opens_with_them():
    target = "gaussian_enhancer.scene.procedural.procedural_scene"
    kind = "gaussian_enhancer.scene.procedural.imperfections.Imperfections"
    values = {"_target_": target, "family": "object", "seed": SEED, **SIZE}
    opened = scene_from_values({**values, "imperfections": {"_target_": kind, "exposure": 0.3, "white_balance": 0.2}})
    expected = photos(Imperfections(exposure=0.3, white_balance=0.2))[4].read()
    assert torch.equal(opened.photos[4].read(), expected)
    with pytest.raises(InputError, match=r"scene\.imperfections"):
        scene_from_values({**values, "imperfections": {"_target_": "builtins.dict"}})


@pytest.mark.parametrize("name", ["exposure", "white_balance", "pose", "wind"])
def test_negative_sizes_are_refused(name):
    with pytest.raises(InputError, match=f"imperfections.{name}"):
        Imperfections(**{name: -0.1})
