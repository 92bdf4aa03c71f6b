import dataclasses
import json
import math

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.cameras import write_scene_cameras
from gaussian_enhancer.scene.path_files import read_path, write_path
from gaussian_enhancer.scene.transforms import load_transforms
from support.captures_on_disk import (  # fmt: skip
    COUNT,
    FX,
    FY,
    HEIGHT,
    WIDTH,
    colmap_to_binary,
    pose,
    write_camera_path,
    write_colmap,
    write_transforms,
)


def assert_ring(cameras) -> None:
    """The cameras are those of the ring, in its order."""
    assert len(cameras) == COUNT
    for index, camera in enumerate(cameras):
        rotation, translation = pose(index)
        torch.testing.assert_close(camera.rotation, torch.from_numpy(rotation).float(), atol=1e-5, rtol=0)
        torch.testing.assert_close(
            camera.world_to_camera[:3, 3], torch.from_numpy(translation).float(), atol=1e-5, rtol=0
        )
        assert (camera.height, camera.width) == (HEIGHT, WIDTH)


def test_nerfstudios_path(tmp_path):
    write_camera_path(tmp_path / "camera_path.json")
    found = read_path(tmp_path / "camera_path.json", 1, 1)
    assert_ring(found.cameras)
    assert found.fps == 24
    K = [[FY, 0, WIDTH / 2], [0, FY, HEIGHT / 2], [0, 0, 1]]
    torch.testing.assert_close(found.cameras[0].K, torch.tensor(K))


def test_transforms_without_photos_and_without_a_size(tmp_path):
    content = write_transforms(tmp_path / "capture")
    for key in ("w", "h", "cx", "cy"):
        content.pop(key)
    (tmp_path / "path.json").write_text(json.dumps(content))
    found = read_path(tmp_path / "path.json", HEIGHT, WIDTH)
    assert_ring(found.cameras)
    assert found.fps is None
    K = [[FX, 0, WIDTH / 2], [0, FY, HEIGHT / 2], [0, 0, 1]]
    torch.testing.assert_close(found.cameras[0].K, torch.tensor(K))


@pytest.mark.parametrize("binary", [False, True])
def test_colmap_by_its_folder_and_by_its_images(tmp_path, binary):
    write_colmap(tmp_path, sparse="model")
    if binary:
        colmap_to_binary(tmp_path / "model")
    assert_ring(read_path(tmp_path / "model", 1, 1).cameras)
    images = tmp_path / "model" / ("images.bin" if binary else "images.txt")
    assert_ring(read_path(images, 1, 1).cameras)


def test_cameras_of_a_fit(tmp_path):
    write_transforms(tmp_path / "capture")
    scene = load_transforms(tmp_path / "capture")
    scene = scene.with_split(tuple(range(COUNT)), ())
    write_scene_cameras(tmp_path / "cameras.json", scene)
    assert_ring(read_path(tmp_path / "cameras.json", 1, 1).cameras)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"camera_path": []}, "give a list with one entry for each camera"),
        ({"camera_path": [3]}, "entry 0: has camera_path = 3"),
        ({"camera_path": [{"fov": 50}]}, "camera 0: has no 'camera_to_world'"),
        ({"camera_path": [{"fov": 180, "camera_to_world": [0.0] * 16}]}, "has fov = 180; give degrees"),
        ({"camera_path": [{"fov": 50, "camera_to_world": [0.0] * 16}]}, "singular camera_to_world"),
        ({"camera_path": [{"fov": 50, "camera_to_world": [0.0] * 15}]}, "of shape"),
        ({"camera_type": "fisheye"}, "has camera_type 'fisheye'; render a perspective path"),
        ({"render_height": 0}, "whole number of pixels"),
        ({"fps": "fast"}, "has fps = 'fast'; give a number"),
    ],
)
def test_a_damaged_path_is_refused_in_one_line(tmp_path, values, told):
    write_camera_path(tmp_path / "p.json", **values)
    with pytest.raises(InputError) as error:
        read_path(tmp_path / "p.json", 1, 1)
    assert told in str(error.value)
    assert "p.json" in str(error.value)


def test_what_is_no_path_is_refused_with_what_would_be(tmp_path):
    (tmp_path / "a.json").write_text('{"cameras": 3}')
    (tmp_path / "a.txt").write_text("hello")
    (tmp_path / "b.json").write_text("{")
    for name, told in {
        "a.json": "is no camera path; give a camera_path.json of nerfstudio, a transforms.json",
        "a.txt": "is no camera path; choose interpolate, orbit, spiral",
        "orbti": "does not exist; choose interpolate, orbit, spiral",
        "c.json": "does not exist",
        "b.json": "is no JSON",
        ".": "holds no COLMAP model",
    }.items():
        with pytest.raises(InputError) as error:
            read_path(tmp_path / name, 1, 1)
        assert told in str(error.value)


def test_a_field_of_view_is_vertical_and_in_degrees(tmp_path):
    content = write_camera_path(tmp_path / "p.json")
    content["camera_path"][0]["fov"] = 90
    (tmp_path / "p.json").write_text(json.dumps(content))
    camera = read_path(tmp_path / "p.json", 1, 1).cameras[0]
    assert float(camera.K[0, 0]) == float(camera.K[1, 1]) == pytest.approx(HEIGHT / 2 / math.tan(math.pi / 4))


def test_a_written_path_is_read_back(tmp_path):
    write_camera_path(tmp_path / "camera_path.json")
    cameras = read_path(tmp_path / "camera_path.json", 1, 1).cameras
    write_path(tmp_path / "own.json", cameras, 24.0)
    found = read_path(tmp_path / "own.json", 1, 1)
    assert found.fps == 24
    assert_ring(found.cameras)
    for camera, same in zip(cameras, found.cameras, strict=True):
        torch.testing.assert_close(same.K, camera.K, atol=1e-3, rtol=0)


def test_what_the_format_cannot_state_is_not_written(tmp_path):
    write_camera_path(tmp_path / "camera_path.json")
    first, second, *_ = read_path(tmp_path / "camera_path.json", 1, 1).cameras
    shifted = dataclasses.replace(second, K=second.K + torch.tensor([[0, 0, 9.0], [0, 0, 0], [0, 0, 0]]))
    for cameras, told in (
        ((), "would list no camera"),
        ((first, second.resized(8, 10)), "camera 1: is of another size"),
        ((first, shifted), "camera 1: .* looks past the middle"),
    ):
        with pytest.raises(InputError, match=told):
            write_path(tmp_path / "own.json", cameras, 24.0)
    assert not (tmp_path / "own.json").exists()
