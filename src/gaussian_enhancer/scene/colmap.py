"""COLMAP captures: a model (binary or text) and a folder of photos.

pycolmap reads the model; binary files are walked first, since a truncated one would end the whole process there.
Axes: p points.
"""

import struct
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.photos import ENDINGS, list_images
from gaussian_enhancer.scene.posed import PosedFile, build_scene, refuse_or_drop
from gaussian_enhancer.scene.scene import Points, Scene
from gaussian_enhancer.scene.splits import Split
from gaussian_enhancer.scene.undistort import Lens

if TYPE_CHECKING:
    import pycolmap

MODEL_FILES = ("cameras", "images", "points3D")
MODEL_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0", ".")


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
        images: folder of the photos in it; with ``images_4`` and the like the intrinsics follow the photos' size.
        sparse: folder of the model in it; ``sparse/0`` or ``sparse`` where None.
        downscale: factor that divides width and height of the photos read.
        split: how to divide the photos; every 8th is held out where None.
        missing: what to do with photos without a camera and cameras without a photo: "error" or "drop".
        background: colour under transparent photos.
        name: the scene's name; the folder's where empty.

    Raises:
        InputError: no or a damaged model, photos and model do not belong together, a bad pose or lens.
    """
    root = Path(path)
    folder = _model_folder(root, sparse)
    model = read_model(folder)
    photos = _by_stem(root / images)
    files: list[PosedFile] = []
    absent: list[str] = []
    for image in model.images.values():
        if not image.has_pose:
            continue
        found = photos.pop(_key(image.name), None)
        if found is None:
            absent.append(image.name)
        else:
            files.append(PosedFile(found[0], found[1], _lens(image.camera, folder), _pose(image)))
    refuse_or_drop(absent, "cameras without a photo", root / images, missing)
    refuse_or_drop([listed for listed, _ in photos.values()], "photos without a camera", root / images, missing)
    return build_scene(
        files, source=root, name=name, downscale=downscale, split=split, background=background, points=_points(model)
    )


def find_model(root: Path) -> Path | None:
    """The first usual folder under ``root`` that holds a COLMAP model, None if there is none."""
    return next((root / sub for sub in MODEL_FOLDERS if model_ending(root / sub) is not None), None)


def model_ending(folder: Path) -> str | None:
    """``.bin`` or ``.txt`` if the folder holds a COLMAP model's images file of that kind, else None."""
    return next((ending for ending in (".bin", ".txt") if (folder / f"images{ending}").is_file()), None)


def read_model(folder: Path) -> "pycolmap.Reconstruction":
    """Read a COLMAP model, binary or text.

    Raises:
        InputError: a file is missing, truncated or malformed.
    """
    import pycolmap

    ending = model_ending(folder)
    if ending is None:
        raise InputError(folder, "holds no COLMAP model", "name the folder of images.bin or images.txt")
    for stem in MODEL_FILES:
        file = folder / f"{stem}{ending}"
        if not file.is_file():
            raise InputError(file, "does not exist", "copy the whole model: cameras, images and points3D")
        if ending == ".bin":
            _check_binary(file)
    try:
        model = pycolmap.Reconstruction()
        (model.read_binary if ending == ".bin" else model.read_text)(str(folder))
    except (ValueError, IndexError, RuntimeError, KeyError, OSError) as error:
        reason = str(error).splitlines()[0][:200]
        raise InputError(folder, f"is no intact COLMAP model ({reason})", "export the model again") from error
    return model


def _model_folder(root: Path, sparse: str | None) -> Path:
    if not root.is_dir():
        raise InputError(root, "is no folder", "name the capture's folder")
    if sparse is not None:
        return root / sparse
    found = find_model(root)
    if found is None:
        raise InputError(root, f"holds no COLMAP model in {', '.join(MODEL_FOLDERS)}", "name its folder with sparse=")
    return found


def _by_stem(folder: Path) -> dict[str, tuple[str, Path]]:
    """Photos under the folder, subfolders included, by path without ending: image_4 folders may hold another kind."""
    if not folder.is_dir():
        list_images(folder)
    files = sorted(p for p in folder.rglob("*") if p.suffix.lower() in ENDINGS and not p.name.startswith("."))
    if not files:
        list_images(folder)
    found: dict[str, tuple[str, Path]] = {}
    for file in files:
        listed = file.relative_to(folder).as_posix()
        if _key(listed) in found:
            twin = found[_key(listed)][0]
            raise InputError(folder, f"holds both {twin} and {listed}", "keep one photo of each name")
        found[_key(listed)] = (listed, file)
    return found


def _key(listed: str) -> str:
    path = Path(listed.replace("\\", "/"))
    return path.with_suffix("").as_posix() if path.suffix.lower() in ENDINGS else path.as_posix()


def _lens(camera: "pycolmap.Camera", folder: Path) -> Lens:
    source = f"camera {camera.camera_id} of {folder}"
    return Lens(camera.model_name, camera.width, camera.height, tuple(camera.params.tolist()), source)


def _pose(image: "pycolmap.Image") -> torch.Tensor:
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3] = torch.from_numpy(np.asarray(image.cam_from_world().matrix()))
    return pose


def _points(model: "pycolmap.Reconstruction") -> Points | None:
    if not model.points3D:
        return None
    positions = np.array([point.xyz for point in model.points3D.values()], dtype=np.float32)
    colours = np.array([point.color for point in model.points3D.values()], dtype=np.float32) / np.float32(255)
    return Points(torch.from_numpy(positions), torch.from_numpy(colours))


def _check_binary(file: Path) -> None:
    """Walk a binary file's records and compare where they end with the file's size."""
    data = file.read_bytes()
    walk = {"cameras": _end_of_cameras, "images": _end_of_images, "points3D": _end_of_points}[file.stem]
    try:
        end = walk(data, struct.unpack_from("<Q", data, 0)[0])
    except (struct.error, ValueError) as error:
        raise InputError(
            file, f"is truncated or damaged ({len(data)} bytes)", "copy or export the model again"
        ) from error
    if end != len(data):
        received = f"has {len(data)} bytes where its records take {end}"
        raise InputError(file, received, "copy or export the model again")


def _end_of_cameras(data: bytes, count: int) -> int:
    import pycolmap

    offset = 8
    for _ in range(count):
        _, model, _, _ = struct.unpack_from("<iiQQ", data, offset)
        if model not in {int(known) for known in pycolmap.CameraModelId.__members__.values()} or model < 0:
            raise ValueError(f"camera model {model}")
        camera = pycolmap.Camera(model=pycolmap.CameraModelId(model))
        offset += 24 + 8 * len(camera.params_info.split(","))
    return offset


def _end_of_images(data: bytes, count: int) -> int:
    offset = 8
    for _ in range(count):
        name_end = data.index(b"\0", offset + 64)
        (observations,) = struct.unpack_from("<Q", data, name_end + 1)
        offset = name_end + 9 + 24 * observations
    return offset


def _end_of_points(data: bytes, count: int) -> int:
    offset = 8
    for _ in range(count):
        (track,) = struct.unpack_from("<Q", data, offset + 43)
        offset += 51 + 8 * track
    return offset
