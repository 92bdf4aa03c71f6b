"""``transforms.json`` captures: NeRF-Synthetic, nerfstudio and instant-ngp.

Their poses are camera-to-world with OpenGL axes (x right, y up, z backward); ours are world-to-camera with OpenCV
axes: flip the y and z columns, then invert. Principal points count from the first pixel's corner, as ours do.
"""

import math
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import abbreviate, reader
from gaussian_enhancer.ply_file import read_ply_elements
from gaussian_enhancer.scene.json_file import member, number, pixels, read_json, text
from gaussian_enhancer.scene.photos import ENDINGS, read_header
from gaussian_enhancer.scene.posed import PosedFile, build_scene, refuse_or_drop
from gaussian_enhancer.scene.scene import Points, Scene
from gaussian_enhancer.scene.splits import Split
from gaussian_enhancer.scene.undistort import Lens
from gaussian_enhancer.types import FARTHEST

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

    Intrinsics are shared or stand in each frame; ``k1 k2 p1 p2 k3`` are undistorted as photos are read, fisheye lenses
    (``camera_model: OPENCV_FISHEYE``, ``is_fisheye``) too. ``train_filenames`` and ``test_filenames`` are the capture's
    own split. ``aabb_scale`` sizes instant-ngp's grid and means nothing here.

    Args:
        path: the capture's folder.
        file: the JSON file's name in it.
        downscale: factor that divides width and height of the photos read.
        split: how to divide the photos; the file's own lists, or every 8th held out, where None.
        missing: what to do with frames that are listed but not on disk: "error" or "drop".
        background: colour under transparent photos.
        name: the scene's name; the folder's where empty.

    Raises:
        InputError: the file is malformed, lacks a value, lists absent photos, or a pose or lens is unusable.
    """
    root = Path(path)
    source = root / file
    content = read_json(source)
    files, absent = _frames(content, source)
    refuse_or_drop(absent, "frames whose photo is not on disk", source, missing)
    files = _with_listed_sides(files, content, source)
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

    Names carry their file's side (``train_r_0.png``), as all three number from 0. Validation photos are part of the
    scene but on neither side.

    Args:
        path: the object's folder.
        downscale: factor that divides width and height of the photos read.
        split: thinning of the training side; the files' sides are kept unless ``split.own`` is false.
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
        found, absent = _frames(read_json(source), source, side)
        refuse_or_drop(absent, "frames whose photo is not on disk", source, missing)
        files += found
    return build_scene(files, source=root, name=name, downscale=downscale, split=split, background=background)


def opencv_world_to_camera(camera_to_world: Float[Tensor, "4 4"]) -> Float[Tensor, "4 4"]:
    """World-to-camera with OpenCV axes from camera-to-world with OpenGL axes."""
    flip = torch.diag(camera_to_world.new_tensor([1.0, -1.0, -1.0, 1.0]))
    return torch.linalg.inv(camera_to_world @ flip)


def _frames(content: Any, source: Path, side: Side | None = None) -> tuple[list[PosedFile], list[str]]:
    frames = member(content, "frames", source)
    if not isinstance(frames, list) or not frames:
        raise InputError(source, "lists no frames", "write the file again with at least two")
    files: list[PosedFile] = []
    absent: list[str] = []
    for index, frame in enumerate(frames):
        context = f"{source} frame {index}"
        listed = text(frame, "file_path", context)
        photo = _on_disk(source.parent, listed)
        if photo is None:
            absent.append(listed)
            continue
        relative = listed.removesuffix(photo.suffix) + photo.suffix
        unique = relative if side is None else f"{side if side != 'neither' else 'val'}/{photo.name}"
        pose = read_pose(frame, "transform_matrix", f"{source} frame {listed}")
        header = read_header(photo)
        lens = read_lens({**content, **frame}, header.height, header.width, source)
        files.append(PosedFile(unique, photo, lens, pose, side))
    return files, absent


def _on_disk(folder: Path, listed: str) -> Path | None:
    """The frame's file; NeRF-Synthetic leaves the ending away."""
    path = folder / listed.replace("\\", "/")
    if path.is_file():
        return path
    candidates = (path.with_name(path.name + ending) for ending in ENDINGS)
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def read_pose(record: Any, key: str, where: str) -> Float[Tensor, "4 4"]:
    """World-to-camera with OpenCV axes (float64) of a camera-to-world matrix with OpenGL axes in a JSON object.

    Args:
        record: the object.
        key: its member, with 3 or 4 rows of 4 numbers, or the 16 numbers row by row.
        where: what the object is, named in errors.

    Raises:
        InputError: the matrix is missing, malformed, singular, not finite, or too far away.
    """
    try:
        matrix = np.array(member(record, key, where), dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(where, f"has a malformed {key} ({error})", "give 4 rows of 4 numbers") from error
    if matrix.shape == (16,):
        matrix = matrix.reshape(4, 4)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise InputError(where, f"has a {key} of shape {matrix.shape}", "give 4 rows of 4 numbers")
    if not np.isfinite(matrix).all():
        raise InputError(where, "has a pose with NaN or infinity", "remove the frame or calibrate again")
    if np.abs(matrix).max() > FARTHEST:
        received = f"has a pose with the value {np.abs(matrix).max():g}"
        raise InputError(where, received, f"bring the scene near the origin: at most {FARTHEST:g} units away")
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3] = torch.from_numpy(matrix[:3])
    if abs(float(torch.linalg.det(pose))) < 1e-6:
        raise InputError(where, f"has a singular {key}", "export rigid poses")
    return opencv_world_to_camera(pose)


def read_lens(values: dict[str, Any], height: int, width: int, source: Path) -> Lens:
    """Intrinsics of one frame: focal lengths, or else fields of view; the principal point by default at the middle.

    Args:
        values: the file's members and, over them, the frame's.
        height: of the picture in pixels where the file states none.
        width: likewise.
        source: the file.

    Raises:
        InputError: a value is missing or no number, or the lens model is unknown.
    """
    width, height = pixels(values, "w", source, width), pixels(values, "h", source, height)
    if "fl_x" in values:
        fx = number(values, "fl_x", source)
    else:
        fx = _focal(number(values, "camera_angle_x", source), width, source)
    fy = _focal(number(values, "camera_angle_y", source), height, source) if _by_angle(values) else fx
    fy = number(values, "fl_y", source, fy)
    centre = number(values, "cx", source, width / 2), number(values, "cy", source, height / 2)
    k1, k2, k3, k4, p1, p2 = (number(values, key, source, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
    model = values.get("camera_model", "OPENCV")
    head = (fx, fy, *centre)
    if model == "OPENCV_FISHEYE" or values.get("is_fisheye"):
        return Lens("OPENCV_FISHEYE", width, height, (*head, k1, k2, k3, k4), str(source))
    if model not in PERSPECTIVE or k4 != 0:
        received = f"has camera_model {abbreviate(model)} with k4 = {k4:g}"
        raise InputError(source, received, f"use {', '.join(PERSPECTIVE)} without k4, or OPENCV_FISHEYE")
    if k3 != 0:
        return Lens("FULL_OPENCV", width, height, (*head, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0), str(source))
    return Lens("OPENCV", width, height, (*head, k1, k2, p1, p2), str(source))


def _by_angle(values: dict[str, Any]) -> bool:
    return "fl_y" not in values and "fl_x" not in values and "camera_angle_y" in values


def _focal(angle: float, extent: int, source: Path) -> float:
    if not 0 < angle < math.pi:
        raise InputError(source, f"has a field of view of {angle:g} radians", "give an angle between 0 and pi")
    return extent / (2 * math.tan(angle / 2))


def _with_listed_sides(files: list[PosedFile], content: dict[str, Any], source: Path) -> list[PosedFile]:
    """Apply nerfstudio's lists of file names, if the file has them.

    Raises:
        InputError: one of the two lists is missing, is no list of names, or both have a name.
    """
    given = [side for side in ("train", "test") if f"{side}_filenames" in content]
    if not given:
        return files
    if len(given) == 1:
        raise InputError(
            source, f"has {given[0]}_filenames alone", "give train_filenames and test_filenames, or neither"
        )
    sides: dict[str, Side] = {}
    for side in ("train", "test"):
        names = content[f"{side}_filenames"]
        if not isinstance(names, list) or not all(isinstance(listed, str) for listed in names):
            raise InputError(source, f"has {side}_filenames = {abbreviate(names)}", "give a list of file names")
        for listed in names:
            if sides.get(listed, side) != side:
                raise InputError(source, f"lists {listed} for training and for testing", "keep it in one list")
            sides[listed] = "train" if side == "train" else "test"
    by_path = {PurePosixPath(listed): side for listed, side in sides.items()}
    return [replace(file, side=by_path.get(PurePosixPath(file.listed), "neither")) for file in files]


def _ply_points(root: Path, content: dict[str, Any]) -> Points | None:
    """Sparse points as nerfstudio exports them, which live in the frames' world."""
    listed = content.get("ply_file_path")
    if listed is None:
        return None
    path = root / str(listed)
    if not path.is_file():
        raise InputError(path, "does not exist", "restore it or remove ply_file_path from the JSON file")
    vertex = read_ply_elements(path, ("vertex",), "write the point cloud again").get("vertex")
    wanted = ("x", "y", "z", "red", "green", "blue")
    if vertex is None or not set(wanted) <= set(vertex.dtype.names or ()):
        raise InputError(path, f"is no intact point cloud: it lacks one of {', '.join(wanted)}", "write it again")
    with np.errstate(over="ignore"):  # beyond single precision is infinite, which the scene refuses
        positions = np.stack([vertex[name] for name in wanted[:3]], 1).astype(np.float32)
        colours = np.stack([vertex[name] for name in wanted[3:]], 1).astype(np.float32)
    return Points(torch.from_numpy(positions), torch.from_numpy(colours / np.float32(255)))
