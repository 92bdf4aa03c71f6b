"""``transforms.json`` captures: NeRF-Synthetic, nerfstudio and instant-ngp.

Their poses are camera-to-world with OpenGL axes (x right, y up, z backward). This project's are world-to-camera with
OpenCV axes; to convert, flip the y and z columns, then invert. Principal points are measured from the outer corner of
the first pixel in both.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import abbreviate, reader
from gaussian_enhancer.ply_file import read_ply_elements
from gaussian_enhancer.scene.json_file import get_member, get_number, get_pixels, get_string, read_json
from gaussian_enhancer.scene.photos import ENDINGS, read_header
from gaussian_enhancer.scene.posed import PosedFile, build_scene, path_without_ending, refuse_or_drop
from gaussian_enhancer.scene.scene import Points, Scene
from gaussian_enhancer.scene.splits import Split
from gaussian_enhancer.scene.undistort import Lens
from gaussian_enhancer.types import MAX_POSE_VALUE

Side = Literal["train", "test", "neither"]
SYNTHETIC_SIDES: dict[str, Side] = {"train": "train", "test": "test", "val": "neither"}
PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "RADIAL", "SIMPLE_RADIAL", "FULL_OPENCV")


@reader
def load_transforms(
    path: str | Path,
    *,
    file: str = "transforms.json",
    downscale: int | float = 1,
    split: Split | None = None,
    missing: str = "error",
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    name: str = "",
) -> Scene:
    """A scene from one ``transforms.json`` of nerfstudio or instant-ngp.

    Intrinsics are given once for all frames or in each frame. Photos are undistorted as they are read, for the
    coefficients ``k1 k2 p1 p2 k3`` and for fisheye lenses (``camera_model: OPENCV_FISHEYE``, ``is_fisheye``).
    ``train_filenames`` and ``test_filenames`` give the capture's own split; like the frames, they may omit the photos'
    endings. ``aabb_scale``, the size of instant-ngp's grid, is ignored.

    Args:
        path: the capture's folder.
        file: name of the JSON file in that folder.
        downscale: factor that divides width and height of the photos read.
        split: how to divide the photos. Where None, the file's own lists are used or, without them, every 8th photo is
            held out.
        missing: what to do with frames that are listed but not on disk, and with names in the lists of a split that no
            frame has: "error" or "drop".
        background: colour under transparent photos.
        name: the scene's name; the folder's where empty.

    Raises:
        InputError: the file is missing or malformed, lacks a value or lists photos that are not on disk or no frames,
            or a pose or lens is invalid.
    """
    root = Path(path)
    source = root / file
    content = read_json(source)
    files, missing_photos = _frames(content, source)
    refuse_or_drop(missing_photos, "frames whose photo is not on disk", source, missing)
    sides = _listed_sides(content, source)
    if sides is not None:
        frames = {path_without_ending(listed) for listed in (*(file.listed for file in files), *missing_photos)}
        names_without_frame = [name for name in sides if name not in frames]
        refuse_or_drop(names_without_frame, "names in its lists of a split that no frame has", source, missing)
        files = [replace(file, side=sides.get(path_without_ending(file.listed), "neither")) for file in files]
    return build_scene(
        files,
        source=root,
        name=name,
        downscale=downscale,
        split=split,
        background=background,
        points=_ply_points(root, content),
    )


@reader
def load_nerf_synthetic(
    path: str | Path,
    *,
    downscale: int | float = 1,
    split: Split | None = None,
    missing: str = "error",
    background: tuple[float, float, float] = (1.0, 1.0, 1.0),
    name: str = "",
) -> Scene:
    """A scene from ``transforms_train.json``, ``_test`` and ``_val`` (Mildenhall et al. 2020), RGBA over white.

    Where names repeat, since all three files number their photos from 0, photo names start with the split of their file
    (``train_r_0.png``).
    Validation photos are part of the scene but of neither its training nor its test split.

    Args:
        path: the object's folder.
        downscale: factor that divides width and height of the photos read.
        split: settings that may thin the training photos; the split of the files is kept unless ``split.own`` is false.
        missing: what to do with frames that are listed but not on disk: "error" or "drop".
        background: colour under the object.
        name: the scene's name; the folder's where empty.

    Raises:
        InputError: see `load_transforms`.
    """
    root = Path(path)
    files: list[PosedFile] = []
    for suffix, side in SYNTHETIC_SIDES.items():
        source = root / f"transforms_{suffix}.json"
        if suffix == "val" and not source.is_file():
            continue
        side_files, missing_photos = _frames(read_json(source), source, side)
        refuse_or_drop(missing_photos, "frames whose photo is not on disk", source, missing)
        files += side_files
    return build_scene(files, source=root, name=name, downscale=downscale, split=split, background=background)


def opencv_world_to_camera(camera_to_world: Float[Tensor, "4 4"]) -> Float[Tensor, "4 4"]:
    """Convert a camera-to-world pose with OpenGL axes to a world-to-camera pose with OpenCV axes."""
    flip = torch.diag(camera_to_world.new_tensor([1.0, -1.0, -1.0, 1.0]))
    return torch.linalg.inv(camera_to_world @ flip)


def _frames(content: Any, source: Path, side: Side | None = None) -> tuple[list[PosedFile], list[str]]:
    frames = get_member(content, "frames", source)
    if not isinstance(frames, list) or not frames:
        raise InputError(source, "lists no frames", "write the file again with at least two")
    files: list[PosedFile] = []
    missing_photos: list[str] = []
    for index, frame in enumerate(frames):
        context = f"{source} frame {index}"
        file_path = get_string(frame, "file_path", context)
        photo = _find_photo(source.parent, file_path)
        if photo is None:
            missing_photos.append(file_path)
            continue
        relative_path = file_path.removesuffix(photo.suffix) + photo.suffix
        unique_path = relative_path if side is None else f"{side if side != 'neither' else 'val'}/{photo.name}"
        pose = read_pose(frame, "transform_matrix", f"{source} frame {file_path}")
        header = read_header(photo)
        lens = read_lens({**content, **frame}, header.height, header.width, source)
        files.append(PosedFile(unique_path, photo, lens, pose, side))
    return files, missing_photos


def _find_photo(folder: Path, listed: str) -> Path | None:
    """Path of a frame's photo, None if there is none; any known ending is tried, as NeRF-Synthetic omits it."""
    path = folder / listed.replace("\\", "/")
    if path.is_file():
        return path
    candidates = (path.with_name(path.name + ending) for ending in (*ENDINGS, *map(str.upper, ENDINGS)))
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def read_pose(record: Any, key: str, where: str) -> Float[Tensor, "4 4"]:
    """Read a camera-to-world matrix with OpenGL axes; return it as world-to-camera with OpenCV axes (float64).

    Args:
        record: the JSON object that holds the matrix.
        key: key of the matrix, given as 3 or 4 rows of 4 numbers or as 16 numbers row by row.
        where: description of the object, named in errors.

    Raises:
        InputError: the matrix is missing, malformed, singular or not finite, or a value exceeds `MAX_POSE_VALUE`.
    """
    try:
        matrix = np.array(get_member(record, key, where), dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(where, f"has a malformed {key} ({error})", "give 4 rows of 4 numbers") from error
    if matrix.shape == (16,):
        matrix = matrix.reshape(4, 4)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise InputError(where, f"has a {key} of shape {matrix.shape}", "give 4 rows of 4 numbers")
    if not np.isfinite(matrix).all():
        raise InputError(where, "has a pose with NaN or infinity", "remove the frame or calibrate again")
    if np.abs(matrix).max() > MAX_POSE_VALUE:
        received = f"has a pose with the value {np.abs(matrix).max():g}"
        raise InputError(where, received, f"bring the scene near the origin: at most {MAX_POSE_VALUE:g} units away")
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3] = torch.from_numpy(matrix[:3])
    if abs(float(torch.linalg.det(pose))) < 1e-6:
        raise InputError(where, f"has a singular {key}", "export rigid poses")
    return opencv_world_to_camera(pose)


def read_lens(values: dict[str, Any], height: int, width: int, source: Path) -> Lens:
    """Intrinsics of one frame, from focal lengths or, where these are missing, fields of view.

    The principal point defaults to the image's centre.

    Args:
        values: the file's members, overridden by the frame's.
        height: height of the image in pixels, used where ``values`` states none.
        width: width, used in the same way.
        source: the file, named in errors.

    Raises:
        InputError: a value is missing or not a number, or the lens model is not supported.
    """
    width, height = get_pixels(values, "w", source, width), get_pixels(values, "h", source, height)
    if "fl_x" in values:
        fx = get_number(values, "fl_x", source)
    else:
        fx = _focal(get_number(values, "camera_angle_x", source), width, source)
    fy = _focal(get_number(values, "camera_angle_y", source), height, source) if _by_angle(values) else fx
    fy = get_number(values, "fl_y", source, fy)
    centre = get_number(values, "cx", source, width / 2), get_number(values, "cy", source, height / 2)
    k1, k2, k3, k4, p1, p2 = (get_number(values, key, source, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
    model = values.get("camera_model", "OPENCV")
    focal_and_centre = (fx, fy, *centre)
    if model == "OPENCV_FISHEYE" or values.get("is_fisheye"):
        return Lens("OPENCV_FISHEYE", width, height, (*focal_and_centre, k1, k2, k3, k4), str(source))
    if model not in PERSPECTIVE or k4 != 0:
        received = f"has camera_model {abbreviate(model)} with k4 = {k4:g}"
        raise InputError(source, received, f"use {', '.join(PERSPECTIVE)} without k4, or OPENCV_FISHEYE")
    if k3 != 0:
        return Lens("FULL_OPENCV", width, height, (*focal_and_centre, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0), str(source))
    return Lens("OPENCV", width, height, (*focal_and_centre, k1, k2, p1, p2), str(source))


def _by_angle(values: dict[str, Any]) -> bool:
    return "fl_y" not in values and "fl_x" not in values and "camera_angle_y" in values


def _focal(angle: float, extent: int, source: Path) -> float:
    if not 0 < angle < math.pi:
        raise InputError(source, f"has a field of view of {angle:g} radians", "give an angle between 0 and pi")
    return extent / (2 * math.tan(angle / 2))


def _listed_sides(content: dict[str, Any], source: Path) -> dict[str, Side] | None:
    """The split of nerfstudio's ``train_filenames`` and ``test_filenames`` by path without ending, None without them.

    Raises:
        InputError: only one of the lists is given, a list does not consist of names, or a name is in both lists.
    """
    splits: tuple[Side, ...] = ("train", "test")
    listed_sides = [side for side in splits if f"{side}_filenames" in content]
    if not listed_sides:
        return None
    if len(listed_sides) == 1:
        received = f"has {listed_sides[0]}_filenames alone"
        raise InputError(source, received, "give train_filenames and test_filenames, or neither")
    sides: dict[str, Side] = {}
    for side in splits:
        names = content[f"{side}_filenames"]
        if not isinstance(names, list) or not all(isinstance(file_name, str) for file_name in names):
            raise InputError(source, f"has {side}_filenames = {abbreviate(names)}", "give a list of file names")
        for file_name in names:
            if sides.setdefault(path_without_ending(file_name), side) != side:
                raise InputError(source, f"lists {file_name} for training and for testing", "keep it in one list")
    return sides


def _ply_points(root: Path, content: dict[str, Any]) -> Points | None:
    """Sparse points of the PLY file named by ``ply_file_path``, in the same world coordinates as the frames."""
    ply_path = content.get("ply_file_path")
    if ply_path is None:
        return None
    path = root / str(ply_path)
    if not path.is_file():
        raise InputError(path, "does not exist", "restore it or remove ply_file_path from the JSON file")
    vertex = read_ply_elements(path, ("vertex",), "write the point cloud again").get("vertex")
    properties = ("x", "y", "z", "red", "green", "blue")
    if vertex is None or not set(properties) <= set(vertex.dtype.names or ()):
        raise InputError(path, f"is no intact point cloud: it lacks one of {', '.join(properties)}", "write it again")
    positions, colours = (np.stack([vertex[name] for name in names], 1) for names in (properties[:3], properties[3:]))
    return Points.of_arrays(positions, colours)
