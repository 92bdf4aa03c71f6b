from pathlib import Path

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.posed import evenly_resized, lens_at_size, orthonormal_pose, unique_names
from gaussian_enhancer.scene.undistort import Lens

SOURCE = Path("capture")


def test_names_are_file_names_unless_they_repeat():
    assert unique_names(["images/a.png", "b\\c.png"], SOURCE) == ["a.png", "c.png"]
    assert unique_names(["left/1.png", "right/1.png"], SOURCE) == ["left_1.png", "right_1.png"]
    assert unique_names(["left/1.png", "right/1.jpg"], SOURCE) == ["left_1.png", "right_1.jpg"]
    assert unique_names(["./../left/1.png", "./../right/1.png"], SOURCE) == ["left_1.png", "right_1.png"]


def test_names_whose_outputs_would_collide_are_refused():
    with pytest.raises(InputError, match=r"capture.*'1'"):
        unique_names(["1.png", "1.jpg"], SOURCE)


def test_rounded_rotation_becomes_exact_and_keeps_its_translation():
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] += 1e-4 * torch.tensor([[1, 2, -1], [0, 1, 1], [2, 0, 1]])
    pose[:3, 3] = torch.tensor([1.0, 2.0, 3.0])
    exact = orthonormal_pose(pose, "a.png")
    torch.testing.assert_close(exact[:3, :3] @ exact[:3, :3].T, torch.eye(3, dtype=torch.float64))
    torch.testing.assert_close(exact, pose, atol=3e-4, rtol=0)
    torch.testing.assert_close(exact[:3, 3], pose[:3, 3])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p[0].fill_(float("inf")), "NaN or infinity"),
        (lambda p: p[:3, :3].mul_(1.2), "scales"),
        (lambda p: p[0].neg_(), "mirrored"),
    ],
)
def test_poses_that_are_not_rigid_are_named(change, message):
    pose = torch.eye(4, dtype=torch.float64)
    change(pose)
    with pytest.raises(InputError, match=rf"a\.png.*{message}"):
        orthonormal_pose(pose, "a.png")


def test_rounded_sizes_fit_and_other_aspects_do_not():
    lens = Lens("PINHOLE", 4946, 3286, (4000.0, 4000.0, 2473.0, 1643.0))
    quarter = lens_at_size(lens, 822, 1237, Path("a.png"))
    assert (quarter.width, quarter.height) == (1237, 822)
    assert quarter.params[0] == pytest.approx(4000 * 1237 / 4946)
    assert lens_at_size(lens, 3286, 4946, Path("a.png")) is lens
    with pytest.raises(InputError, match=r"a\.png.*1237x800.*4946x3286"):
        lens_at_size(lens, 800, 1237, Path("a.png"))


@pytest.mark.parametrize(
    ("calibrated", "size"),
    [
        ((3648, 5472), (1066, 1600)),
        ((3956, 5280), (1198, 1600)),
        ((3361, 5187), (1036, 1600)),
        ((3361, 5187), (1680, 2594)),
        ((5472, 3648), (1600, 1066)),
        ((1090, 1959), (545, 980)),  # Tanks and Temples, train
        ((1091, 1957), (546, 979)),  # Tanks and Temples, truck
    ],
)
def test_sizes_that_3dgs_shrinks_photos_to_fit_in_both_directions(calibrated, size):
    assert evenly_resized(size, calibrated)
    assert evenly_resized(calibrated, size)
    narrower = size[0], size[1] - 5
    assert not evenly_resized(narrower, calibrated)
    assert not evenly_resized(calibrated, narrower)


@pytest.mark.parametrize(
    ("size", "calibrated"), [((1000, 998), (1000, 1000)), ((1500, 1998), (1500, 2000)), ((48, 66), (48, 64))]
)
def test_a_crop_of_two_pixels_is_no_resizing(size, calibrated):
    assert not evenly_resized(size, calibrated)
    assert not evenly_resized(calibrated, size)
