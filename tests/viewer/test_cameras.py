import dataclasses
import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import Camera, identity_camera
from gaussian_enhancer.viewer.cameras import PageCamera, upward


def turned() -> Camera:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.8, 0.2]).as_matrix()
    pose[:3, 3] = 0.4, -1.0, 2.5
    return Camera.from_matrices([[50, 0, 32], [0, 50, 24], [0, 0, 1]], pose, 48, 64)


def test_a_photos_camera_comes_back_at_its_own_size():
    camera = turned()
    same = PageCamera.of(camera).to_camera(64)
    torch.testing.assert_close(same.world_to_camera, camera.world_to_camera, atol=1e-5, rtol=0)
    torch.testing.assert_close(same.K, camera.K, atol=1e-4, rtol=0)
    assert (same.height, same.width) == (48, 64)


def test_the_field_of_view_stays_at_other_sizes_whose_sides_are_even():
    page = PageCamera.of(turned())
    for width in (17, 64, 333):
        camera = page.to_camera(width)
        assert camera.width % 2 == camera.height % 2 == 0
        assert 2 * math.atan(camera.height / 2 / float(camera.K[1, 1])) == pytest.approx(page.fov)
        assert float(camera.K[0, 0]) == pytest.approx(float(camera.K[1, 1]))
    assert page.to_camera(1).width == 16


def test_a_narrowed_camera_sees_the_middle_columns():
    page = PageCamera.of(turned())
    whole, half = page.to_camera(64), page.middle_half().to_camera(32)
    assert (half.height, half.width) == (48, 32)
    point = torch.tensor([0.1, 0.2, 1.5])
    pixels = [camera.K @ point for camera in (whole, half)]
    (x, y), (x_half, y_half) = ((float(p[0] / p[2]), float(p[1] / p[2])) for p in pixels)
    assert x_half == pytest.approx(x - 16, abs=1e-3)
    assert y_half == pytest.approx(y, abs=1e-3)


def test_what_is_no_camera_is_refused_and_a_hidden_page_has_a_picture():
    page = PageCamera.of(turned())
    for broken in ({"position": (0.0, math.nan, 0.0)}, {"wxyz": (0.0, 0.0, 0.0, 0.0)}, {"fov": 0.0}):
        with pytest.raises(InputError, match="the page's camera: is PageCamera"):
            dataclasses.replace(page, **broken).to_camera(64)
    assert dataclasses.replace(page, aspect=0.0).to_camera(64).height == 8 * 64
    assert dataclasses.replace(page, aspect=1e9).to_camera(640).height == 80


def test_upward_is_the_mean_and_the_first_where_cameras_cancel():
    level = identity_camera(8, 8, 8.0)
    assert upward([level, level]).tolist() == [0, -1, 0]
    over = Camera(level.K, torch.diag(torch.tensor([-1.0, -1.0, 1.0, 1.0])), 8, 8)
    assert upward([level, over]).tolist() == [0, -1, 0]
