"""Undistortion of photos to an ideal pinhole camera.

A distorted photo is resampled on the pixel grid of an ideal pinhole. The ray of each ideal pixel is projected through
the lens model to a position in the photo, where the colour is sampled; the lens model is therefore never inverted. The
models are COLMAP's, evaluated by pycolmap. Axes: c channels, h w the photo's size, H W the ideal image's size.
"""

import importlib
import signal
import threading
from dataclasses import dataclass
from functools import cache, lru_cache
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.json_file import LARGEST_SIDE

if TYPE_CHECKING:
    import pycolmap

IDEAL_MODELS = ("PINHOLE", "SIMPLE_PINHOLE")
LEAST_FOCAL, LARGEST_FOCAL, FARTHEST_CENTRE = 1e-3, 1e5, 100.0
"""Accepted range of focal lengths, and maximum absolute coordinate of the principal point, in longer sides."""


@cache
def load_pycolmap() -> ModuleType:
    """Import pycolmap, which is slow to import, and restore the handler of SIGTERM.

    pycolmap's glog sets a SIGTERM handler that prints a stack trace and allocates memory. If the signal arrives while
    the process itself allocates memory, the handler deadlocks on the allocator's lock.
    """
    previous_handler = signal.getsignal(signal.SIGTERM)
    module = importlib.import_module("pycolmap")
    # Only the main thread may set handlers.
    if threading.current_thread() is threading.main_thread() and previous_handler is not None:
        signal.signal(signal.SIGTERM, previous_handler)
    return module


@dataclass(frozen=True)
class Lens:
    """Intrinsics of a photo in one of COLMAP's camera models; the first pixel's centre is at (0.5, 0.5).

    Args:
        model: COLMAP's name: PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV, OPENCV_FISHEYE, ...
        width: of the photo in pixels.
        height: of the photo in pixels.
        params: the model's parameters in COLMAP's order (focal lengths, principal point, coefficients).
        source: file that the values come from, named in errors.

    Raises:
        InputError: a value is not finite; a size, focal length or principal point is out of range; or the model is
            unknown, has no focal length or has another number of parameters.
    """

    model: str
    width: int
    height: int
    params: tuple[float, ...]
    source: str = "camera"

    def __post_init__(self) -> None:
        if not all(np.isfinite(self.params)):
            raise InputError(self.source, f"has intrinsics {self.params}", "calibrate again: all must be finite")
        if not (1 <= self.width <= LARGEST_SIDE and 1 <= self.height <= LARGEST_SIDE):
            raise InputError(self.source, f"has a camera of {self.width}x{self.height} pixels", "correct the size")
        focal, centre = self._focal_and_centre()
        side = max(self.width, self.height)
        if not side * LEAST_FOCAL <= min(focal) <= max(focal) <= side * LARGEST_FOCAL:
            worst = min(focal) if min(focal) < side * LEAST_FOCAL else max(focal)
            received = f"has focal length {worst:g} for a camera of {self.width}x{self.height} pixels"
            raise InputError(self.source, received, "give one above 0 pixels, 0.001 to 100,000 times the size")
        if max(abs(centre[0]), abs(centre[1])) > side * FARTHEST_CENTRE:
            received = f"has its principal point at {centre[0]:g}, {centre[1]:g}"
            raise InputError(self.source, received, "give it in pixels, in the picture or near it")

    def _focal_and_centre(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Focal lengths and principal point; the slow import of pycolmap is avoided for the model PINHOLE."""
        if self.model == "PINHOLE" and len(self.params) == 4:
            return (self.params[0], self.params[1]), (self.params[2], self.params[3])
        camera = self.colmap
        if not camera.verify_params():
            received = f"has {len(self.params)} parameters for {self.model} ({camera.params_info})"
            raise InputError(self.source, received, "give one value for each")
        focal = camera.focal_length_x, camera.focal_length_y
        return focal, (camera.principal_point_x, camera.principal_point_y)

    @property
    def colmap(self) -> "pycolmap.Camera":
        """The lens as a pycolmap camera."""
        pycolmap = load_pycolmap()
        if self.model not in pycolmap.CameraModelId.__members__ or self.model == "INVALID":
            model_names = ", ".join(name for name in pycolmap.CameraModelId.__members__ if name != "INVALID")
            raise InputError(self.source, f"has camera model {self.model!r}", f"use one of {model_names}")
        camera = pycolmap.Camera(model=self.model, width=self.width, height=self.height, params=list(self.params))
        if not list(camera.focal_length_idxs()):  # else reading the focal length terminates the process
            remedy = "cut pictures of a pinhole camera out of the panorama first"
            raise InputError(self.source, f"has camera model {self.model}, which has no focal length", remedy)
        return camera

    @property
    def distorted(self) -> bool:
        """Whether the lens has distortion, so that its photos differ from those of a pinhole camera."""
        if self.model in IDEAL_MODELS:
            return False
        camera = self.colmap
        coefficients = camera.params[list(camera.extra_params_idxs())]
        fisheye = "FISHEYE" in self.model
        return fisheye or bool(np.any(coefficients != 0))

    def resized(self, height: int, width: int) -> "Lens":
        """The same lens for another size of the photo."""
        camera = self.colmap
        camera.rescale(width, height)
        return Lens(self.model, width, height, tuple(camera.params.tolist()), self.source)


def ideal_pinhole(lens: Lens) -> tuple[Float[Tensor, "3 3"], int, int]:
    """The pinhole camera that a photo is undistorted to: K in pixels (float64), height, width.

    The focal length is kept; the size is the largest without blank pixels (COLMAP's ``image_undistorter``).

    Raises:
        InputError: the lens model is not injective within the image, so that no such camera exists.
    """
    if not lens.distorted:
        (fx, fy), (cx, cy) = lens._focal_and_centre()
        K = torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=torch.float64)
        return K, lens.height, lens.width
    pycolmap, camera = load_pycolmap(), lens.colmap
    ideal = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), camera)
    K = torch.from_numpy(ideal.calibration_matrix())
    x = torch.linspace(0.5, ideal.width - 0.5, 64, dtype=torch.float64)
    y = torch.linspace(0.5, ideal.height - 0.5, 64, dtype=torch.float64)
    border = torch.cat([torch.stack(torch.meshgrid(x, y[[0, -1]], indexing="xy"), -1).flatten(0, 1),
                        torch.stack(torch.meshgrid(x[[0, -1]], y, indexing="xy"), -1).flatten(0, 1)])  # fmt: skip
    distorted = distort(border, K, lens)
    slack = 2.0
    inside = (distorted > -slack) & (distorted < distorted.new_tensor([lens.width, lens.height]) + slack)
    if not bool(inside.all()):
        received = f"has {lens.model} coefficients {lens.params} that fold the picture's border over"
        raise InputError(lens.source, received, "calibrate again with a lens model of less distortion")
    return K, ideal.height, ideal.width


def distort(points: Float[Tensor, "n 2"], K: Float[Tensor, "3 3"], lens: Lens) -> Float[Tensor, "n 2"]:
    """Project pixels of an ideal pinhole to positions in the lens's photo; NaN where the lens cannot see them.

    Args:
        points: pixel positions (x, y) in the ideal image.
        K: intrinsics of the ideal pinhole.
        lens: the lens that took the photo.
    """
    rays = torch.cat([points.double(), torch.ones_like(points[:, :1]).double()], 1) @ torch.linalg.inv(K.double()).T
    distorted = lens.colmap.img_from_cam(rays.numpy())
    return torch.from_numpy(np.asarray(distorted)).to(points.dtype)


def undistort(image: Float[Tensor, "c h w"], lens: Lens) -> Float[Tensor, "c H W"]:
    """Resample a photo taken by ``lens`` to its ideal pinhole (bicubic, clamped to [0, 1])."""
    if not lens.distorted:
        return image
    grid = _sampling_grid(lens)
    ideal = functional.grid_sample(image[None], grid, mode="bicubic", padding_mode="border", align_corners=False)
    return ideal[0].clamp(0, 1)


@lru_cache(maxsize=2)
def _sampling_grid(lens: Lens) -> Float[Tensor, "1 H W 2"]:
    """Normalised coordinates for `grid_sample`; cached, since a capture has only a few lenses."""
    K, height, width = ideal_pinhole(lens)
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    distorted = distort(torch.stack([x, y], -1).flatten(0, 1).double(), K, lens)
    normalised = 2 * distorted / distorted.new_tensor([lens.width, lens.height]) - 1
    return normalised.float().reshape(1, height, width, 2)
