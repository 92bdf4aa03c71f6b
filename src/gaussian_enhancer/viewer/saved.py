"""Files that the viewer saves: pictures with their cameras, and camera paths that the job ``video`` reads."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.camera_path import refuse_outside
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.path import smooth_path
from gaussian_enhancer.scene.path_files import write_path
from gaussian_enhancer.types import Camera
from gaussian_enhancer.viewer.cameras import PageCamera

FPS = 30.0
_numbering = threading.Lock()
"""Held from the choice of a file's number until the file exists: several browsers may save at the same time."""


@dataclass(frozen=True)
class SavedFiles:
    """The folder of saved files. It is created with the first file; no file is overwritten.

    Args:
        folder: path of the folder.

    Raises:
        InputError: the path is a file.
    """

    folder: Path

    def __post_init__(self) -> None:
        if self.folder.is_file():
            raise InputError(self.folder, "cannot be written: it is a file", "name a folder")

    def save_view(self, picture: Float[Tensor, "3 _ _"], camera: Camera) -> Path:
        """Save a picture as ``view_NNN.png``, and its camera as a path of one frame, ``view_NNN.json``.

        Args:
            picture: the picture as it is shown.
            camera: camera of the whole picture.

        Raises:
            InputError: the disk is full, or the folder cannot be written.
        """
        with _numbering:
            file = self._next("view", ".png")
            write_image(file, picture)
        write_path(file.with_suffix(".json"), [camera], FPS)
        return file

    def save_path(self, cameras: Sequence[Camera], fps: float) -> Path:
        """Save a camera path as ``path_NNN.json``.

        Args:
            cameras: cameras of the path's frames.
            fps: frames per second.

        Raises:
            InputError: the disk is full, or the folder cannot be written.
        """
        with _numbering:
            file = self._next("path", ".json")
            write_path(file, cameras, fps)
        return file

    @property
    def count(self) -> int:
        """How many pictures and paths the folder holds."""
        return sum(1 for kind in ("view_*.png", "path_*.json") for _ in self.folder.glob(kind))

    def _next(self, kind: str, ending: str) -> Path:
        numbers = [int(file.stem[5:]) for file in self.folder.glob(f"{kind}_*{ending}") if file.stem[5:].isdigit()]
        return self.folder / f"{kind}_{max(numbers, default=0) + 1:03d}{ending}"


def path_through_cameras(
    waypoints: Sequence[PageCamera], width: int, seconds: float, capture: Sequence[Camera], fps: float = FPS
) -> tuple[Camera, ...]:
    """Cameras of a path at constant speed through cameras that were added on the page, all with the first one's aspect.

    Args:
        waypoints: the cameras that were added, in the path's order.
        width: width of the frames in pixels.
        seconds: duration of the path.
        capture: cameras of the capture.
        fps: frames per second.

    Raises:
        InputError: there are fewer than two cameras, or the path leaves the capture, which the job ``video`` refuses.
    """
    if len(waypoints) < 2:
        raise InputError("camera path", f"passes {len(waypoints)} cameras", "add the cameras it shall pass, at least 2")
    cameras = [replace(camera, aspect=waypoints[0].aspect).to_camera(width) for camera in waypoints]
    path = smooth_path(cameras, max(2, round(seconds * fps)), even_speed=True)
    refuse_outside(path, capture, "camera path")
    return path
