"""The development captures, where the machine has them: geometry against what structure from motion measured."""

import os
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch
from torch.nn import functional

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.capture import open_capture
from gaussian_enhancer.scene.neighbours import choose_references

pytestmark = pytest.mark.captures
DATA = os.environ.get("GAUSSIAN_ENHANCER_DATA", "")


@pytest.fixture
def capture():
    if not DATA:
        pytest.skip("GAUSSIAN_ENHANCER_DATA does not name the folder of development captures")

    def path(name):
        folder = Path(DATA) / "captures" / name
        if not folder.is_dir():
            pytest.skip(f"{folder} is absent")
        return folder

    return path


def project(camera, positions):
    """Pixel positions and which points lie in front of the camera, inside its image."""
    local = positions @ camera.rotation.T + camera.world_to_camera[:3, 3]
    pixels = (local @ camera.K.T)[:, :2] / local[:, 2:]
    inside = (local[:, 2] > 0) & (pixels > 0).all(1) & (pixels < torch.tensor([camera.width, camera.height])).all(1)
    return pixels, inside


def colours_at(photo, pixels):
    grid = 2 * pixels / torch.tensor([photo.camera.width, photo.camera.height]) - 1
    return functional.grid_sample(photo.read()[None], grid[None, None], align_corners=False)[0, :, 0].T


def seen_by_both(folder, scene, *names):
    """Positions of the points that structure from motion tracked in both photos (all of them without tracks)."""
    if not (folder / "sparse").is_dir():
        return scene.points.positions
    model = pycolmap.Reconstruction(str(folder / "sparse/0"))
    pair = {image.image_id for image in model.images.values() if image.name in names}
    tracked = [p for p in model.points3D.values() if pair <= {e.image_id for e in p.track.elements}]
    return torch.tensor(np.array([p.xyz for p in tracked]), dtype=torch.float32)


def correlation(a, b):
    return float(np.corrcoef(a.mean(1).numpy(), b.mean(1).numpy())[0, 1])


@pytest.mark.parametrize("name", ["monstree", "panel17"])
def test_points_reproject_to_their_observations(capture, name):
    scene, model = open_capture(capture(name)), pycolmap.Reconstruction(str(capture(name) / "sparse/0"))
    cameras = {photo.name: photo.camera for photo in scene.photos}
    errors = []
    for image in model.images.values():
        seen = [p for p in image.points2D if p.has_point3D()]
        positions = torch.tensor(np.array([model.points3D[p.point3D_id].xyz for p in seen]), dtype=torch.float32)
        pixels, _ = project(cameras[image.name], positions)
        errors.append((pixels - torch.tensor(np.array([p.xy for p in seen]))).norm(dim=1))
    assert float(torch.cat(errors).mean()) < 2


@pytest.mark.parametrize("name", ["monstree", "panel17", "axe", "boruszyn", "lewis", "buddha", "banana", "berlin"])
def test_neighbouring_photos_agree_where_points_project(capture, name):
    """Two neighbours show the points that both see in nearly one colour; pairing other points destroys that."""
    scene = open_capture(capture(name), downscale=4)
    photo = scene.photos[0]
    other = scene.photos[choose_references(photo, scene.photos, 1)[0]]
    positions = seen_by_both(capture(name), scene, photo.name, other.name)
    here, inside_here = project(photo.camera, positions)
    there, inside_there = project(other.camera, positions)
    both = inside_here & inside_there
    assert int(both.sum()) > 100
    a, b = colours_at(photo, here[both]), colours_at(other, there[both])
    assert correlation(a, b) > 0.8
    assert correlation(a, b) > correlation(a, b.flip(0)) + 0.3


def test_fox_drops_its_missing_frames_and_loses_its_distortion(capture):
    with pytest.raises(InputError, match="17 frames"):
        open_capture(capture("fox"))
    scene = open_capture(capture("fox"), missing="drop")
    assert len(scene.photos) == 50
    assert len(scene.test) == 7
    photo = scene.photos[0]
    image = photo.read()
    assert image.shape == (3, photo.camera.height, photo.camera.width)
    assert 1890 < photo.camera.height <= 1920
    assert 0.2 < float(image.mean()) < 0.8


def test_berlins_points_lie_inside_its_photos(capture):
    scene = open_capture(capture("berlin"))
    shares = [float(project(photo.camera, scene.points.positions)[1].float().mean()) for photo in scene.photos]
    assert min(shares) > 0.6
    assert max(shares) > 0.95


def test_photos_without_cameras_are_no_capture(capture):
    with pytest.raises(InputError, match="recognised"):
        open_capture(capture("lund"))
