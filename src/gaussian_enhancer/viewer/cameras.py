"""Cameras of the viewer's page: pinhole cameras with the principal point at the centre of the picture.

A page's camera has OpenCV axes, a camera-to-world pose as position and quaternion (w, x, y, z), and a vertical field of
view in radians.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.camera_geometry import mean_up
from gaussian_enhancer.types import Camera

MIN_SIDE = 16
"""Smallest side of a picture in pixels."""
MAX_SIDE_RATIO = 8.0
"""Largest ratio of a picture's sides."""


@dataclass(frozen=True)
class PageCamera:
    """Camera of a page.

    Args:
        position: position of the camera in the world, in scene units.
        wxyz: quaternion of the rotation from the camera's axes to the world's.
        fov: vertical field of view in radians.
        aspect: width over height of the page's picture.
    """

    position: tuple[float, ...]
    wxyz: tuple[float, ...]
    fov: float
    aspect: float

    @classmethod
    def of(cls, camera: Camera) -> "PageCamera":
        """Convert a camera, keeping its pose, vertical field of view and aspect.

        Args:
            camera: camera of a photo.
        """
        x, y, z, w = Rotation.from_matrix(camera.rotation.T.double().cpu().numpy()).as_quat()
        position = tuple(camera.centre.double().tolist())
        fov = 2 * math.atan(camera.height / (2 * float(camera.K[1, 1])))
        return cls(position, (float(w), float(x), float(y), float(z)), fov, camera.width / camera.height)

    def to_camera(self, width: int) -> Camera:
        """Convert to the camera of a picture of a given width.

        Args:
            width: width of the picture in pixels; its height follows from the aspect. Both are rounded to even numbers,
                as in videos.

        Raises:
            InputError: the camera is invalid: a number is not finite, the quaternion is 0, or the field of view is not
                between 0 and 180 degrees.
        """
        if not (np.isfinite([*self.position, *self.wxyz]).all() and any(self.wxyz) and 0 < self.fov < math.pi):
            raise InputError("the page's camera", f"is {self}", "reset the view")
        width = max(MIN_SIDE, width // 2 * 2)
        height = max(MIN_SIDE, round(width / min(max(self.aspect, 1 / MAX_SIDE_RATIO), MAX_SIDE_RATIO) / 2) * 2)
        focal = height / (2 * math.tan(self.fov / 2))
        w, x, y, z = self.wxyz
        rotation = Rotation.from_quat([x, y, z, w]).as_matrix().T
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ np.asarray(self.position, dtype=np.float64)
        K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        return Camera(K, torch.from_numpy(pose).float(), height, width)

    def middle_half(self) -> "PageCamera":
        """The camera of the middle half of the picture's columns."""
        return dataclasses.replace(self, aspect=self.aspect / 2)


def upward(cameras: Sequence[Camera]) -> np.ndarray:
    """Mean up direction of cameras as a unit vector; the up direction of the first camera where the mean is near 0.

    Args:
        cameras: cameras of a capture, at least one.
    """
    mean = mean_up(cameras)
    up = mean if np.linalg.norm(mean) > 1e-3 else mean_up(cameras[:1])
    return up / np.linalg.norm(up)
