"""Saved views and paths, and that the job video reads them."""

import dataclasses

import pytest
import torch
from hydra import compose

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.video import compute_path
from gaussian_enhancer.scene.path_files import read_path
from gaussian_enhancer.scene.photos import read_photo
from gaussian_enhancer.viewer.cameras import PageCamera
from gaussian_enhancer.viewer.saved import SavedFiles, path_through_cameras
from support.job_config import initialised
from support.synthetic_runs import plane_camera

CAPTURE = [plane_camera(index, 48, 64) for index in range(8)]
KEPT = [PageCamera.of(CAPTURE[index]) for index in (0, 3, 7)]


def test_a_saved_path_is_the_path_that_video_lays(tmp_path):
    path_cameras = path_through_cameras(KEPT, 320, 2.0, CAPTURE, 10.0)
    file = SavedFiles(tmp_path / "saved").save_path(path_cameras, 10.0)
    assert file.name == "path_001.json"
    with initialised():
        path = compute_path(compose("video", [f"path={file}"]), CAPTURE)
    assert path.fps == 10
    assert len(path.cameras) == len(path_cameras) == 20
    for camera, same in zip(path_cameras, path.cameras, strict=True):
        assert (same.height, same.width) == (camera.height, camera.width) == (240, 320)
        torch.testing.assert_close(same.world_to_camera, camera.world_to_camera, atol=1e-5, rtol=0)
        torch.testing.assert_close(same.K, camera.K, atol=1e-2, rtol=1e-5)
    for camera, capture_camera in zip((path_cameras[0], path_cameras[-1]), (CAPTURE[0], CAPTURE[7]), strict=True):
        torch.testing.assert_close(camera.world_to_camera, capture_camera.world_to_camera, atol=1e-5, rtol=0)


def test_frames_have_the_first_cameras_aspect_and_each_its_own_lens():
    wide = dataclasses.replace(KEPT[1], aspect=3.0, fov=1.5)
    path_cameras = path_through_cameras([KEPT[0], wide], 320, 1.0, CAPTURE)
    assert {(camera.height, camera.width) for camera in path_cameras} == {(240, 320)}
    assert len(path_cameras) == 30
    assert float(path_cameras[0].K[1, 1]) > float(path_cameras[-1].K[1, 1])


def test_a_path_that_video_would_refuse_is_not_saved():
    with pytest.raises(InputError, match="camera path: passes 1 cameras; add the cameras"):
        path_through_cameras(KEPT[:1], 320, 2.0, CAPTURE)
    far = dataclasses.replace(KEPT[1], position=(0.0, 0.0, -50.0))
    with pytest.raises(InputError, match="camera path: leaves the capture"):
        path_through_cameras([KEPT[0], far], 320, 2.0, CAPTURE)


def test_a_view_is_saved_with_its_camera_and_none_is_replaced(tmp_path):
    saved = SavedFiles(tmp_path / "saved")
    assert saved.count == 0
    assert not saved.folder.exists()
    picture = torch.rand(3, 48, 64, generator=torch.Generator().manual_seed(0))
    camera = KEPT[1].to_camera(64)
    assert [saved.save_view(picture, camera).name for _ in range(2)] == ["view_001.png", "view_002.png"]
    assert float((read_photo(saved.folder / "view_001.png") - picture).abs().max()) <= 0.5 / 255 + 1e-6
    (same,) = read_path(saved.folder / "view_001.json", 1, 1).cameras
    torch.testing.assert_close(same.world_to_camera, camera.world_to_camera, atol=1e-5, rtol=0)
    assert saved.count == 2


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written: it is a file; name a folder"):
        SavedFiles(tmp_path / "file")
