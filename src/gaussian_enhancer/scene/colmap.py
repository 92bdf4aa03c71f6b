"""COLMAP captures: a model (binary or text) and a folder of photos.

`colmap_model` reads the model's files.
"""

import os
from collections.abc import Iterator
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import reader
from gaussian_enhancer.scene.colmap_model import ColmapImage, ColmapModel, read_colmap_model
from gaussian_enhancer.scene.photos import ENDINGS, list_images
from gaussian_enhancer.scene.posed import PosedFile, build_scene, path_without_ending, refuse_or_drop
from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.scene.splits import Split

MODEL_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0", ".")


@reader
def load_colmap(
    path: str | Path,
    *,
    images: str = "images",
    sparse: str | None = None,
    downscale: int | float = 1,
    split: Split | None = None,
    missing: str = "error",
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    name: str = "",
) -> Scene:
    """A scene from a COLMAP capture; distorted photos are undistorted as they are read.

    Args:
        path: the capture's folder.
        images: subfolder of the photos. Intrinsics are scaled to the photos' size, such as that of ``images_4``.
        sparse: subfolder of the model; the first of `MODEL_FOLDERS` that holds one where None.
        downscale: factor that divides width and height of the photos read.
        split: how to divide the photos; every 8th is held out where None.
        missing: what to do with photos without a camera and cameras without a photo: "error" or "drop".
        background: colour under transparent photos.
        name: the scene's name; the folder's where empty.

    Raises:
        InputError: the model is missing or damaged, photos and model do not match, or a pose or lens is invalid.
    """
    root = Path(path)
    folder = _model_folder(root, sparse)
    model = read_model(folder)
    photos = _by_stem(root / images)
    files: list[PosedFile] = []
    images_without_photo: list[str] = []
    for image in model.images:
        photo = photos.pop(path_without_ending(image.name), None)
        if photo is None:
            images_without_photo.append(image.name)
        else:
            files.append(PosedFile(photo[0], photo[1], model.cameras[image.camera], camera_pose(image)))
    refuse_or_drop(images_without_photo, "cameras without a photo", root / images, missing)
    photos_without_image = [relative_path for relative_path, _ in photos.values()]
    refuse_or_drop(photos_without_image, "photos without a camera", root / images, missing)
    return build_scene(
        files, source=root, name=name, downscale=downscale, split=split, background=background, points=model.points
    )


def find_model(root: Path) -> Path | None:
    """The first of `MODEL_FOLDERS` under ``root`` that holds a COLMAP model, None if there is none."""
    return next((root / subfolder for subfolder in MODEL_FOLDERS if model_ending(root / subfolder) is not None), None)


def model_ending(folder: Path) -> str | None:
    """Ending of the folder's COLMAP images file, ``.bin`` or ``.txt``; None if there is no such file."""
    return next((ending for ending in (".bin", ".txt") if (folder / f"images{ending}").is_file()), None)


def read_model(folder: Path) -> ColmapModel:
    """Read a COLMAP model, binary or text.

    Raises:
        InputError: a file is missing, truncated or malformed.
    """
    ending = model_ending(folder)
    if ending is None:
        raise InputError(folder, "holds no COLMAP model", "name the folder of images.bin or images.txt")
    return read_colmap_model(folder, ending)


def _model_folder(root: Path, sparse: str | None) -> Path:
    if not root.is_dir():
        raise InputError(root, "is no folder", "name the capture's folder")
    if sparse is not None:
        return root / sparse
    model_folder = find_model(root)
    if model_folder is None:
        raise InputError(root, f"holds no COLMAP model in {', '.join(MODEL_FOLDERS)}", "name its folder with sparse=")
    return model_folder


def _by_stem(folder: Path) -> dict[str, tuple[str, Path]]:
    """Names and paths of the photos in a folder and its subfolders, by relative path without ending.

    Endings are ignored because folders such as ``images_4`` may hold another image format than the model names.
    """
    paths = _walk(folder) if folder.is_dir() else ()
    files = sorted(p for p in paths if p.suffix.lower() in ENDINGS and not p.name.startswith("."))
    if not files:
        others = sorted(path.name for path in folder.parent.glob(f"{folder.name}_*") if path.is_dir())
        if others and not folder.is_dir():
            raise InputError(folder, "is no folder", f"use scene=colmap scene.images={others[0]}")
        list_images(folder)  # raises the error for a missing folder, or one without images
    photos: dict[str, tuple[str, Path]] = {}
    for file in files:
        relative_path = file.relative_to(folder).as_posix()
        if path_without_ending(relative_path) in photos:
            earlier_path = photos[path_without_ending(relative_path)][0]
            raise InputError(folder, f"holds both {earlier_path} and {relative_path}", "keep one photo of each name")
        photos[path_without_ending(relative_path)] = (relative_path, file)
    return photos


def _walk(folder: Path) -> Iterator[Path]:
    """Every file under a folder; unlike with `Path.rglob`, an unreadable folder raises an error."""

    def refuse(error: OSError) -> None:
        raise error

    for parent, _, names in os.walk(folder, onerror=refuse):
        yield from (Path(parent) / name for name in names)


def camera_pose(image: ColmapImage) -> Float[Tensor, "4 4"]:
    """World-to-camera pose of a model's image (float64)."""
    from kornia.geometry.conversions import quaternion_to_rotation_matrix

    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = quaternion_to_rotation_matrix(torch.tensor(image.rotation, dtype=torch.float64))
    pose[:3, 3] = torch.tensor(image.translation, dtype=torch.float64)
    return pose
