"""``cameras.json`` of a fitted splat: 3DGS's list, extended by principal point and split.

3DGS (``utils/camera_utils.py``) writes id, img_name, width, height, position, rotation (camera-to-world, row by row),
fx and fy, test cameras first. It writes neither the principal point, which it assumes at the image's centre, nor the
split.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.input_files import abbreviate, reader
from gaussian_enhancer.scene.json_file import get_member, get_number, get_pixels, get_string, read_json
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.scene.undistort import Lens, ideal_pinhole
from gaussian_enhancer.types import Camera, orthonormal_pose

Side = Literal["train", "test"]


@dataclass(frozen=True)
class ListedCamera:
    """One entry of a ``cameras.json``.

    Args:
        name: the photo's name, with or without ending.
        camera: pose and intrinsics at the listed size.
        split: "train" or "test"; None in files written by 3DGS.
    """

    name: str
    camera: Camera
    split: Side | None = None


def write_cameras(path: Path, views: Sequence[Photo | RenderedView], splits: Sequence[Side]) -> None:
    """Write a ``cameras.json`` atomically.

    Args:
        path: the file to write.
        views: views with cameras.
        splits: "train" or "test" for each view.

    Raises:
        InputError: a view has no camera, the counts differ, or the file cannot be written.
    """
    if len(views) != len(splits):
        raise InputError("splits", f"has {len(splits)} entries for {len(views)} views", "give one for each view")
    entries = [_entry(i, view, side) for i, (view, side) in enumerate(zip(views, splits, strict=True))]
    write_text(path, json.dumps(entries, indent=1))


def write_scene_cameras(path: Path, scene: Scene) -> None:
    """Write a scene's ``cameras.json``, test cameras first as in 3DGS, without photos that are in neither split."""
    views = [*scene.test_photos, *scene.train_photos]
    sides: list[Side] = ["test"] * len(scene.test) + ["train"] * len(scene.train)  # type: ignore[assignment]
    write_cameras(path, views, sides)


@reader
def read_cameras(path: Path) -> tuple[ListedCamera, ...]:
    """The cameras of a ``cameras.json``, in the file's order.

    Raises:
        InputError: the file is missing or malformed, or a camera is invalid.
    """
    entries = read_json(path)
    if not isinstance(entries, list) or not entries:
        raise InputError(path, "lists no cameras", "write it again, as a list with one entry for each view")
    return tuple(_parse_camera(entry, f"{path} entry {i}") for i, entry in enumerate(entries))


def cameras_by_stem(cameras: Sequence[ListedCamera], source: Path) -> dict[str, Camera]:
    """Cameras by their photos' names without ending.

    Raises:
        InputError: two cameras have the same name.
    """
    by_stem: dict[str, Camera] = {}
    for entry in cameras:
        stem = Path(entry.name).stem
        if stem in by_stem:
            raise InputError(source, f"lists {stem!r} more than once", "name every camera after its photo")
        by_stem[stem] = entry.camera
    return by_stem


def _entry(index: int, view: Photo | RenderedView, side: Side) -> dict[str, Any]:
    camera = view.camera
    if camera is None:
        raise InputError(view.name, "has no camera", "give cameras for all views or for none")
    return {
        "id": index,
        "img_name": view.name,
        "width": camera.width,
        "height": camera.height,
        "position": camera.centre.double().tolist(),
        "rotation": camera.rotation.T.double().tolist(),
        "fx": float(camera.K[0, 0]),
        "fy": float(camera.K[1, 1]),
        "cx": float(camera.K[0, 2]),
        "cy": float(camera.K[1, 2]),
        "split": side,
    }


def _parse_camera(entry: Any, where: str) -> ListedCamera:
    width, height = get_pixels(entry, "width", where), get_pixels(entry, "height", where)
    fx, fy = get_number(entry, "fx", where), get_number(entry, "fy", where)
    cx, cy = get_number(entry, "cx", where, width / 2), get_number(entry, "cy", where, height / 2)
    K, _, _ = ideal_pinhole(Lens("PINHOLE", width, height, (fx, fy, cx, cy), where))
    try:
        camera_to_world = torch.tensor(get_member(entry, "rotation", where), dtype=torch.float64).reshape(3, 3)
        position = torch.tensor(get_member(entry, "position", where), dtype=torch.float64).reshape(3)
    except (TypeError, ValueError, RuntimeError, OverflowError) as error:
        raise InputError(where, f"has a malformed pose ({error})", "give a 3x3 rotation and a position") from error
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = camera_to_world.T
    pose[:3, 3] = -camera_to_world.T @ position
    split = entry.get("split")
    if split not in (None, "train", "test"):
        raise InputError(where, f"has split {abbreviate(split)}", 'give "train" or "test"')
    camera = Camera(K.float(), orthonormal_pose(pose, where).float(), height, width)
    return ListedCamera(get_string(entry, "img_name", where), camera, split)
