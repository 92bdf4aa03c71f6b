"""A scene: posed photos, read lazily and split into training and held-out photos.

Axes: h height, w width, p points.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Real
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import Camera


@dataclass(frozen=True)
class Points:
    """A coloured point cloud, usually from structure from motion.

    Args:
        positions: world coordinates.
        colours: sRGB in [0, 1].
    """

    positions: Float[Tensor, "p 3"]
    colours: Float[Tensor, "p 3"]

    @staticmethod
    def of_arrays(positions: Real[np.ndarray, "p 3"], colours: Real[np.ndarray, "p 3"]) -> "Points":
        """Points from arrays of any precision, with colours from 0 to 255.

        Values beyond single precision become infinite; `scene.posed.build_scene` refuses them.
        """
        with np.errstate(over="ignore"):
            positions, colours = positions.astype(np.float32), colours.astype(np.float32)
        return Points(torch.from_numpy(positions), torch.from_numpy(colours / np.float32(255)))


@dataclass(frozen=True)
class Photo:
    """One photo of a scene. Pixels are read on demand and not cached.

    Args:
        name: the file's name with ending, unique in its scene and also used for outputs.
        camera: camera of the photo; None in a folder without cameras.
        read: returns the image, shape (3, height, width), [0, 1], composited over the scene's background.
        read_depth: returns true z depth, shape (1, height, width); known only in procedural scenes, else None.
        read_alpha: returns the object's coverage, shape (1, height, width); None where it is unknown.
    """

    name: str
    camera: Camera | None
    read: Callable[[], Float[Tensor, "3 h w"]]
    read_depth: Callable[[], Float[Tensor, "1 h w"]] | None = None
    read_alpha: Callable[[], Float[Tensor, "1 h w"]] | None = None

    def require_camera(self) -> Camera:
        """The camera of a photo that must have one.

        Raises:
            InputError: the photo has no camera.
        """
        if self.camera is None:
            raise InputError(f"photo {self.name}", "has no camera", "give its camera, or leave the photo out")
        return self.camera


@dataclass(frozen=True)
class Scene:
    """Photos sorted by name, split into training photos, which may serve as references, and held-out photos.

    Args:
        name: short name, used in records and folders.
        photos: all photos, sorted by name.
        train: indices of the photos to which a splat is fitted and which serve as references.
        test: indices of the held-out photos, which are never references.
        background: colour behind the scene, composited under renders.
        points: sparse points; None if the capture has none.
    """

    name: str
    photos: tuple[Photo, ...]
    train: tuple[int, ...]
    test: tuple[int, ...]
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    points: Points | None = None

    @property
    def train_photos(self) -> tuple[Photo, ...]:
        """The photos for fitting and for references."""
        return tuple(self.photos[i] for i in self.train)

    @property
    def train_cameras(self) -> tuple[Camera, ...]:
        """The cameras of the training photos that have one."""
        return tuple(photo.camera for photo in self.train_photos if photo.camera is not None)

    @property
    def test_photos(self) -> tuple[Photo, ...]:
        """The held-out photos."""
        return tuple(self.photos[i] for i in self.test)

    def with_split(self, train: tuple[int, ...], test: tuple[int, ...]) -> "Scene":
        """The same photos under another split."""
        return dataclasses.replace(self, train=train, test=test)
