"""OpenSfM captures: ``reconstruction.json`` beside a folder ``images``.

OpenSfM has the same axes and pose convention as this project (x right, y down, z forward; world-to-camera, stored as an
axis-angle vector and a translation). Its image coordinates are divided by max(width, height) and measured from the
image's centre.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import abbreviate, reader
from gaussian_enhancer.scene.json_file import get_member, get_number, get_object, get_pixels, get_string, read_json
from gaussian_enhancer.scene.photos import list_images
from gaussian_enhancer.scene.posed import PosedFile, build_scene, refuse_or_drop
from gaussian_enhancer.scene.scene import Points, Scene
from gaussian_enhancer.scene.splits import Split
from gaussian_enhancer.scene.undistort import Lens


@reader
def load_opensfm(
    path: str | Path,
    *,
    file: str | None = None,
    component: int = 0,
    images: str = "images",
    downscale: int | float = 1,
    split: Split | None = None,
    missing: str = "error",
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    name: str = "",
) -> Scene:
    """A scene from an OpenSfM capture (perspective, Brown or fisheye cameras, undistorted as photos are read).

    Args:
        path: the capture's folder.
        file: name of the reconstruction file in that folder; see `find_reconstruction` where None.
        component: index of one of the file's disconnected reconstructions, the largest first.
        images: subfolder of the photos.
        downscale: factor that divides width and height of the photos read.
        split: how to divide the photos; every 8th is held out where None.
        missing: what to do with photos without a camera and cameras without a photo: "error" or "drop".
        background: colour under transparent photos.
        name: the scene's name; the folder's where empty.

    Raises:
        InputError: the file is missing or malformed, photos and cameras do not match, or a pose or lens is invalid.
    """
    root = Path(path)
    source = root / file if file else _reconstruction_file(root)
    reconstructions = read_json(source)
    if not isinstance(reconstructions, list) or not 0 <= component < len(reconstructions):
        count = len(reconstructions) if isinstance(reconstructions, list) else 0
        raise InputError(source, f"has {count} reconstructions, number {component} does not exist", "set component=")
    content = reconstructions[component]
    cameras = get_object(content, "cameras", source)
    lenses = {key: _lens(camera, f"{source} camera {key}") for key, camera in cameras.items()}
    photos = {photo.name: photo for photo in list_images(root / images)}
    shots = get_object(content, "shots", source)
    refuse_or_drop([shot for shot in shots if shot not in photos], "shots without a photo", source, missing)
    refuse_or_drop([photo for photo in photos if photo not in shots], "photos without a camera", root / images, missing)
    files = [_parse_shot(key, shots[key], photos[key], lenses, source) for key in shots if key in photos]
    return build_scene(
        files,
        source=root,
        name=name,
        downscale=downscale,
        split=split,
        background=background,
        points=_points(content, source),
    )


def find_reconstruction(root: Path) -> Path | None:
    """Path of ``reconstruction.json`` or else of the only ``reconstruction*.json``; None without a single one."""
    if (root / "reconstruction.json").is_file():
        return root / "reconstruction.json"
    similar = sorted(root.glob("reconstruction*.json"))
    return similar[0] if len(similar) == 1 else None


def rotation_from_axis_angle(vector: Float[Tensor, " 3"]) -> Float[Tensor, "3 3"]:
    """Rotation by ``|vector|`` radians around ``vector``."""
    from kornia.geometry.conversions import axis_angle_to_rotation_matrix

    return axis_angle_to_rotation_matrix(vector[None])[0]


def _reconstruction_file(root: Path) -> Path:
    reconstruction = find_reconstruction(root)
    if reconstruction is None:
        raise InputError(root, "holds no reconstruction.json, nor a single file like it", "name it with file=")
    return reconstruction


def _lens(camera: Any, where: str) -> Lens:
    width, height = get_pixels(camera, "width", where), get_pixels(camera, "height", where)
    size = max(width, height)
    k1, k2, k3 = (get_number(camera, key, where, 0.0) for key in ("k1", "k2", "k3"))
    model = camera.get("projection_type", "perspective")
    if model in ("perspective", "simple_radial"):
        shared_focal = get_number(camera, "focal", where, get_number(camera, "focal_x", where, 0.0)) * size
        return Lens("RADIAL", width, height, (shared_focal, width / 2, height / 2, k1, k2), where)
    if model == "fisheye":
        focal = get_number(camera, "focal", where) * size
        return Lens("OPENCV_FISHEYE", width, height, (focal, focal, width / 2, height / 2, k1, k2, 0.0, 0.0), where)
    focals = get_number(camera, "focal_x", where, 0.0) * size, get_number(camera, "focal_y", where, 0.0) * size
    cx = width / 2 + get_number(camera, "c_x", where, 0.0) * size
    cy = height / 2 + get_number(camera, "c_y", where, 0.0) * size
    if model == "brown":
        p1, p2 = get_number(camera, "p1", where, 0.0), get_number(camera, "p2", where, 0.0)
        params = (*focals, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0)
        return Lens("FULL_OPENCV", width, height, params, where)
    if model == "fisheye_opencv":
        k4 = get_number(camera, "k4", where, 0.0)
        return Lens("OPENCV_FISHEYE", width, height, (*focals, cx, cy, k1, k2, k3, k4), where)
    remedy = "use perspective, brown, fisheye or fisheye_opencv"
    raise InputError(where, f"has projection_type {abbreviate(model)}", remedy)


def _parse_shot(key: str, shot: Any, photo: Path, lenses: dict[str, Lens], source: Path) -> PosedFile:
    context = f"{source} shot {key}"
    camera = get_string(shot, "camera", context)
    if camera not in lenses:
        received = f"names the camera {camera!r}, which is not listed"
        raise InputError(context, received, "export the reconstruction again")
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = rotation_from_axis_angle(_vector(shot, "rotation", context))
    pose[:3, 3] = _vector(shot, "translation", context)
    return PosedFile(key, photo, lenses[camera], pose)


def _vector(record: Any, key: str, where: object) -> Float[Tensor, " 3"]:
    values = get_member(record, key, where)
    if not isinstance(values, list) or len(values) != 3 or not all(isinstance(v, int | float) for v in values):
        raise InputError(where, f"has {key} = {abbreviate(values)}", "give three numbers")
    vector = torch.tensor(values, dtype=torch.float64)
    if not bool(torch.isfinite(vector).all()):
        remedy = "remove the shot or reconstruct again: NaN or infinity"
        raise InputError(where, f"has {key} = {abbreviate(values)}", remedy)
    return vector


def _points(content: Any, source: Path) -> Points | None:
    if content.get("points") is None:
        return None
    points = get_object(content, "points", source)
    if not points:
        return None
    try:
        positions = np.array([point["coordinates"] for point in points.values()], dtype=np.float64).reshape(-1, 3)
        colours = np.array([point["color"] for point in points.values()], dtype=np.float64).reshape(-1, 3)
    except (TypeError, KeyError, ValueError, OverflowError) as error:
        raise InputError(source, f"has malformed points ({error})", "export the reconstruction again") from error
    return Points.of_arrays(positions, colours)
