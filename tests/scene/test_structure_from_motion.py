"""Cameras of a textured corner: recovered up to rotation, shift and scale, and never made up."""

import pytest
import torch

from gaussian_enhancer.scene.colmap import camera_pose, read_model
from gaussian_enhancer.scene.structure_from_motion import UnposedImage, reconstruct
from support.projection import project
from support.textured_corner import FOCAL, HEIGHT, WIDTH, corner_camera, corner_render, corner_view

VIEWS = (0, 2, 3, 5, 6, 8)
STRANGE = 3


def images() -> list[UnposedImage]:
    """Two renders, of which one shows another place, and six photos twice as fine."""

    def photo(index: int) -> torch.Tensor:
        return corner_view(corner_camera(index, 2 * HEIGHT, 2 * WIDTH))[0]

    def render(index: int) -> torch.Tensor:
        return corner_render(corner_view(corner_camera(index), seed=7 if index == STRANGE else 0)[0])

    renders = [UnposedImage(f"render_{i}.png", lambda i=i: render(i), True, True) for i in (4, STRANGE)]
    return renders + [UnposedImage(f"photo_{i}.png", lambda i=i: photo(i), False, False) for i in VIEWS]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("model")
    told = []
    assert reconstruct(images(), folder, lambda *step: told.append(step))
    assert {part for part, _, _ in told} == {"features", "matches", "cameras"}
    assert all(0 < done <= total for _, done, total in told)
    return folder


def similarity_error(found: torch.Tensor, true: torch.Tensor) -> float:
    """Largest distance of points from true ones after the best similarity (Umeyama 1991), over their spread."""
    a, b = found - found.mean(0), true - true.mean(0)
    U, S, Vh = torch.linalg.svd(b.T @ a)
    signs = torch.tensor([1.0, 1.0, float(torch.sign(torch.linalg.det(U @ Vh)))], dtype=a.dtype)
    scale = (S * signs).sum() / a.square().sum()
    moved = scale * a @ (U @ torch.diag(signs) @ Vh).T
    return float((moved - b).norm(dim=1).max() / b.norm(dim=1).max())


def test_cameras_are_those_that_took_the_images(folder):
    model = read_model(folder)
    poses = {image.name: camera_pose(image) for image in model.images}
    names = ["render_4.png", *(f"photo_{i}.png" for i in VIEWS)]
    assert sorted(poses) == sorted(names)
    found = torch.stack([-poses[name][:3, :3].T @ poses[name][:3, 3] for name in names])
    true = torch.stack([corner_camera(i).centre.double() for i in (4, *VIEWS)])
    assert similarity_error(found, true) < 0.02
    assert model.points is not None
    assert len(model.points.positions) > 100


def test_images_of_one_size_share_their_intrinsics(folder):
    model = read_model(folder)
    kinds = {image.camera: image.name.split("_")[0] for image in model.images}
    assert sorted(kinds.values()) == ["photo", "render"]
    for number, kind in kinds.items():
        lens, scale = model.cameras[number], 2 if kind == "photo" else 1
        assert (lens.model, lens.width) == ({1: "SIMPLE_PINHOLE", 2: "SIMPLE_RADIAL"}[scale], scale * WIDTH)
        assert lens.params[0] == pytest.approx(scale * FOCAL, rel=0.01)


def test_an_image_of_another_place_is_given_no_camera(folder):
    assert f"render_{STRANGE}.png" not in {image.name for image in read_model(folder).images}


@pytest.mark.slow
def test_the_same_images_give_the_same_model(folder, tmp_path):
    assert reconstruct(images(), tmp_path)
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_images_without_a_place_in_common_give_no_model(tmp_path):
    def noise(index: int) -> torch.Tensor:
        return torch.rand(3, 64, 96, generator=torch.Generator().manual_seed(index))

    flat = [UnposedImage(f"photo_{i}.png", lambda: torch.full((3, 64, 96), 0.5), False, False) for i in range(3)]
    noisy = [UnposedImage(f"noise_{i}.png", lambda i=i: noise(i), True, i == 0) for i in range(3)]
    assert not reconstruct([*noisy, *flat], tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_damaged_image_leaves_nothing_behind(tmp_path):
    def damaged() -> torch.Tensor:
        raise ValueError("damaged")

    with pytest.raises(ValueError, match="damaged"):
        reconstruct([UnposedImage("photo_0.png", damaged, False, False)], tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_corner_is_seen_as_cameras_see_it():
    """The scene of these tests: a point of one view lies where another camera sees it."""
    one, other = corner_camera(0), corner_camera(5)
    photo, depth = corner_view(one)
    seen, _ = corner_view(other)
    y, x = 90, 150
    local = torch.linalg.inv(one.K) @ torch.tensor([x + 0.5, y + 0.5, 1.0]) * depth[0, y, x]
    at = project(other, one.rotation.T @ (local - one.world_to_camera[:3, 3]))
    assert (seen[:, int(at[1]), int(at[0])] - photo[:, y, x]).abs().max() < 0.15
