"""Reading of camera paths from other programs' files, and writing of paths in nerfstudio's format.

nerfstudio's viewer writes ``camera_path.json`` (``camera_path``, ``render_height``, ``render_width``, ``fps``). Its
poses are camera-to-world with OpenGL axes; its fields of view are vertical, in degrees.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_json
from gaussian_enhancer.input_files import abbreviate, reader
from gaussian_enhancer.scene.cameras import read_cameras
from gaussian_enhancer.scene.colmap import camera_pose, read_model
from gaussian_enhancer.scene.json_file import get_number, get_object, get_pixels, read_json
from gaussian_enhancer.scene.transforms import read_lens, read_pose
from gaussian_enhancer.scene.undistort import Lens, ideal_pinhole
from gaussian_enhancer.types import Camera, orthonormal_pose

KNOWN = "a camera_path.json of nerfstudio, a transforms.json, a cameras.json, or a folder with a COLMAP model"
MOST_FRAMES = 1_000_000


@dataclass(frozen=True)
class FilePath:
    """A camera path from a file.

    Args:
        cameras: cameras in the file's order; those of a COLMAP model are sorted by image name.
        fps: frames per second; None where the file states none.
    """

    cameras: tuple[Camera, ...]
    fps: float | None = None


@reader
def read_path(path: str | Path, height: int, width: int) -> FilePath:
    """Read a camera path. A distorted lens is replaced by the pinhole that its photos would be undistorted to.

    Args:
        path: nerfstudio's ``camera_path.json``, a ``transforms.json``, a ``cameras.json`` in 3DGS's format, a folder
            with a COLMAP model, or that model's images file. Photos are not needed.
        height: height of the frames in pixels, used where a ``transforms.json`` states none.
        width: width, used in the same way.

    Raises:
        InputError: the file is missing or has another format, or one of its cameras is invalid.
    """
    file = Path(path)
    if file.is_dir():
        return _from_colmap(file)
    if file.name in ("images.bin", "images.txt"):
        return _from_colmap(file.parent)
    if file.suffix.lower() != ".json":
        received = "does not exist" if not file.exists() else "is no camera path"
        raise InputError(path, received, f"choose interpolate, orbit, spiral, or give {KNOWN}")
    content = read_json(file)
    if isinstance(content, list):
        return FilePath(tuple(entry.camera for entry in read_cameras(file)))
    if isinstance(content, dict) and "camera_path" in content:
        return _from_nerfstudio(content, file)
    if isinstance(content, dict) and "frames" in content:
        return _from_transforms(content, file, height, width)
    raise InputError(path, "is no camera path", f"give {KNOWN}")


def write_path(path: str | Path, cameras: Sequence[Camera], fps: float) -> None:
    """Write a ``camera_path.json`` in the format of nerfstudio's viewer, atomically; `read_path` reads it.

    Args:
        path: file to write, ending in .json.
        cameras: at least one pinhole camera. All have one size, square pixels and their principal point at the image's
            centre, since the vertical field of view is the only intrinsic value that the format stores.
        fps: frames per second.

    Raises:
        InputError: there is no camera, the cameras differ in size, pixels are not square, a principal point is not at
            the centre, or the file cannot be written.
    """
    if not cameras:
        raise InputError(path, "would list no camera", "give at least one")
    height, width = cameras[0].height, cameras[0].width
    axis_flip = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))
    image_centre = torch.tensor([width / 2, height / 2], dtype=torch.float64)
    entries = []
    for index, camera in enumerate(cameras):
        fx, fy = float(camera.K[0, 0]), float(camera.K[1, 1])
        has_same_size = (camera.height, camera.width) == (height, width)
        has_square_pixels = math.isclose(fx, fy, rel_tol=1e-4)
        is_centred = torch.allclose(camera.K[:2, 2].cpu().double(), image_centre, atol=1e-3 * max(height, width))
        if not (is_centred and has_same_size and has_square_pixels):
            received = "is of another size than the first, or looks past the middle of its image"
            raise InputError(f"camera {index}", received, "give upright pinholes of one size")
        pose = torch.linalg.inv(camera.world_to_camera.cpu().double()) @ axis_flip
        angle = math.degrees(2 * math.atan(height / (2 * fy)))
        entries.append({"camera_to_world": pose.flatten().tolist(), "fov": angle, "aspect": width / height})
    size = {"render_height": height, "render_width": width}
    content = {"camera_type": "perspective", **size, "fps": fps, "seconds": len(cameras) / fps}
    write_json(path, {**content, "is_cycle": False, "keyframes": [], "camera_path": entries})


def _from_nerfstudio(content: dict[str, Any], source: Path) -> FilePath:
    height, width = get_pixels(content, "render_height", source), get_pixels(content, "render_width", source)
    kind = content.get("camera_type", "perspective")
    if kind != "perspective":
        raise InputError(source, f"has camera_type {abbreviate(kind)}", "render a perspective path")
    cameras = []
    for index, entry in enumerate(_entries(content, "camera_path", source)):
        context = f"{source} camera {index}"
        angle = get_number(entry, "fov", context)
        if not 0 < angle < 180:
            raise InputError(context, f"has fov = {angle:g}", "give degrees above 0 and below 180")
        focal = height / (2 * math.tan(math.radians(angle) / 2))
        lens = Lens("PINHOLE", width, height, (focal, focal, width / 2, height / 2), context)
        cameras.append(_camera(lens, read_pose(entry, "camera_to_world", context), context))
    fps = get_number(content, "fps", source) if content.get("fps") is not None else None
    return FilePath(tuple(cameras), fps)


def _from_transforms(content: dict[str, Any], source: Path, height: int, width: int) -> FilePath:
    cameras = []
    for index, frame in enumerate(_entries(content, "frames", source)):
        context = f"{source} frame {index}"
        lens = read_lens({**content, **frame}, height, width, source)
        cameras.append(_camera(lens, read_pose(frame, "transform_matrix", context), context))
    return FilePath(tuple(cameras))


def _from_colmap(folder: Path) -> FilePath:
    model = read_model(folder)
    images = sorted(model.images, key=lambda image: image.name)
    if not images:
        raise InputError(folder, "lists no images", "give a model with the path's cameras")
    return FilePath(tuple(_camera(model.cameras[i.camera], camera_pose(i), f"{folder} {i.name}") for i in images))


def _entries(content: dict[str, Any], key: str, source: Path) -> Sequence[Any]:
    entries = content[key]
    if not isinstance(entries, list) or not entries:
        raise InputError(source, f"has {key} = {abbreviate(entries)}", "give a list with one entry for each camera")
    if len(entries) > MOST_FRAMES:
        raise InputError(source, f"lists {len(entries)} cameras", f"give at most {MOST_FRAMES}")
    for index in range(len(entries)):
        get_object({key: entries[index]}, key, f"{source} entry {index}")
    return entries


def _camera(lens: Lens, world_to_camera: Float[Tensor, "4 4"], where: str) -> Camera:
    K, height, width = ideal_pinhole(lens)
    return Camera(K.float(), orthonormal_pose(world_to_camera, where).float(), height, width)
