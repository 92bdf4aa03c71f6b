"""Reader of COLMAP's model files, binary or text, that validates every record.

pycolmap's own reader terminates the process on some damaged files and reads a zero quaternion as the identity rotation.
Axes: p points.
"""

import math
import struct
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import abbreviate, read_bytes, read_text, reader
from gaussian_enhancer.scene.scene import Points
from gaussian_enhancer.scene.undistort import Lens, load_pycolmap

REMEDY = "copy or export the model again"
_POINT = np.dtype([("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8")])


@dataclass(frozen=True)
class ColmapImage:
    """One image of a model.

    Args:
        name: file name as the model lists it.
        camera: number of its camera in the model.
        rotation: of the world-to-camera pose, a unit quaternion (w, x, y, z).
        translation: of the world-to-camera pose.
    """

    name: str
    camera: int
    rotation: tuple[float, float, float, float]
    translation: tuple[float, float, float]


@dataclass(frozen=True)
class ColmapModel:
    """The parts of a COLMAP model that a capture needs.

    Args:
        cameras: lenses by camera number.
        images: posed images, in the file's order.
        points: sparse points; None where there are none.
    """

    cameras: dict[int, Lens]
    images: tuple[ColmapImage, ...]
    points: Points | None


@reader
def read_colmap_model(folder: Path, ending: str) -> ColmapModel:
    """Read the ``cameras``, ``images`` and ``points3D`` files of a model.

    Args:
        folder: folder of the model.
        ending: ".bin" or ".txt".

    Raises:
        InputError: a file is missing, truncated or malformed, a number is repeated, an image's camera is not listed, or
            a pose's quaternion is not of unit length.
    """
    cameras_file, images_file, points_file = (folder / f"{stem}{ending}" for stem in ("cameras", "images", "points3D"))
    for file in (cameras_file, images_file, points_file):
        if not file.is_file():
            raise InputError(file, "does not exist", "copy the whole model: cameras, images and points3D")
    is_binary = ending == ".bin"
    lenses = _unique(_binary_cameras(cameras_file) if is_binary else _text_cameras(cameras_file), cameras_file)
    images_by_number = _unique(_binary_images(images_file) if is_binary else _text_images(images_file), images_file)
    for image in images_by_number.values():
        if image.camera not in lenses:
            raise InputError(images_file, f"gives {image.name} camera {image.camera}, which is not listed", REMEDY)
    return ColmapModel(
        lenses,
        tuple(images_by_number.values()),
        _binary_points(points_file) if is_binary else _text_points(points_file),
    )


def _unique(records: Iterator[tuple[int, Any]], file: Path) -> dict[int, Any]:
    unique: dict[int, Any] = {}
    for number, record in records:
        if number in unique:
            raise InputError(file, f"lists number {number} more than once", REMEDY)
        unique[number] = record
    return unique


def _image(name: str, camera: int, pose: tuple[float, ...], file: Path) -> ColmapImage:
    length = math.hypot(*pose[:4])
    if not abs(length - 1) <= 0.01:  # written so that NaN is refused too
        raise InputError(file, f"gives {name} a quaternion of length {length:g} as rotation", "calibrate again")
    w, x, y, z = (component / length for component in pose[:4])
    return ColmapImage(name, camera, (w, x, y, z), (pose[4], pose[5], pose[6]))


@lru_cache
def _models() -> dict[int, tuple[str, int]]:
    """Name and parameter count of every camera model, by COLMAP's number of the model."""
    pycolmap = load_pycolmap()
    names = {int(kind): name for name, kind in pycolmap.CameraModelId.__members__.items() if name != "INVALID"}
    return {number: (name, len(pycolmap.Camera(model=name).params_info.split(","))) for number, name in names.items()}


def _damaged_file(file: Path, size: int) -> InputError:
    return InputError(file, f"is truncated or damaged ({size} bytes)", REMEDY)


def _records(file: Path, data: bytes, record: Any) -> Iterator[tuple[int, Any]]:
    """Iterate over the records of a binary file: ``record(offset)`` returns the next offset, a number and a value."""
    try:
        (count,), offset = struct.unpack_from("<Q", data, 0), 8
        for _ in range(count):
            offset, number, value = record(offset)
            yield number, value
    except (struct.error, ValueError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        raise _damaged_file(file, len(data)) from error
    if offset != len(data):
        raise InputError(file, f"has {len(data)} bytes where its records take {offset}", REMEDY)


def _binary_cameras(file: Path) -> Iterator[tuple[int, Lens]]:
    data = read_bytes(file, 4)

    def record(offset: int) -> tuple[int, int, Lens]:
        number, kind, width, height = struct.unpack_from("<IiQQ", data, offset)
        if kind not in _models():
            raise ValueError(f"camera model {kind}")
        name, count = _models()[kind]
        params = struct.unpack_from(f"<{count}d", data, offset + 24)
        return offset + 24 + 8 * count, number, Lens(name, width, height, params, f"camera {number} of {file.parent}")

    return _records(file, data, record)


def _binary_images(file: Path) -> Iterator[tuple[int, ColmapImage]]:
    data = read_bytes(file, 4)

    def record(offset: int) -> tuple[int, int, ColmapImage]:
        number, *pose, camera = struct.unpack_from("<I7dI", data, offset)
        end = data.index(b"\0", offset + 64)
        (observation_count,) = struct.unpack_from("<Q", data, end + 1)
        name = _decode_name(data[offset + 64 : end], file)
        return end + 9 + 24 * observation_count, number, _image(name, camera, tuple(pose), file)

    return _records(file, data, record)


def _decode_name(name: bytes, file: Path) -> str:
    try:
        return name.decode()
    except UnicodeDecodeError as error:
        remedy = "rename the photo and export the model again"
        raise InputError(file, f"lists the photo {name[:80]!r}, which is no UTF-8", remedy) from error


def _binary_points(file: Path) -> Points | None:
    data = read_bytes(file, 4)
    record_offsets = array("q")

    def record(offset: int) -> tuple[int, int, None]:
        (track_length,) = struct.unpack_from("<Q", data, offset + 43)
        record_offsets.append(offset)
        return offset + 51 + 8 * track_length, len(record_offsets), None

    for _ in _records(file, data, record):
        pass
    if not record_offsets:
        return None
    rows = np.frombuffer(data, np.uint8)[np.asarray(record_offsets)[:, None] + np.arange(_POINT.itemsize)]
    points = rows.view(_POINT)[:, 0]
    return Points.of_arrays(points["xyz"], points["rgb"])


def _lines(file: Path) -> Iterator[tuple[int, str]]:
    """Numbered lines of a text file without comment lines; empty lines are kept."""
    lines = read_text(file, 8).split("\n")
    return ((number, line.strip()) for number, line in enumerate(lines, 1) if not line.lstrip().startswith("#"))


def _malformed(file: Path, number: int, line: str) -> InputError:
    return InputError(file, f"has a malformed line {number}: {abbreviate(line)}", REMEDY)


def _text_cameras(file: Path) -> Iterator[tuple[int, Lens]]:
    for line_number, line in _lines(file):
        fields = line.split()
        if not fields:
            continue
        try:
            camera_number, width, height = int(fields[0]), int(fields[2]), int(fields[3])
            params = tuple(float(word) for word in fields[4:])
        except (ValueError, IndexError) as error:
            raise _malformed(file, line_number, line) from error
        yield camera_number, Lens(fields[1], width, height, params, f"camera {camera_number} of {file.parent}")


def _text_images(file: Path) -> Iterator[tuple[int, ColmapImage]]:
    """Parse two lines for each image: its pose, then its observations (x, y, point), which may be empty."""
    lines = _lines(file)
    for line_number, line in lines:
        if not line:
            continue
        fields = line.split(maxsplit=9)
        try:
            image_number, camera = int(fields[0]), int(fields[8])
            pose, name = tuple(float(word) for word in fields[1:8]), fields[9]
        except (ValueError, IndexError) as error:
            raise _malformed(file, line_number, line) from error
        next_number, observations = next(lines, (line_number + 1, ""))
        values = observations.split()
        if len(values) % 3 or (values and not values[2].lstrip("-").isdigit()):
            raise _malformed(file, next_number, observations)
        yield image_number, _image(name, camera, pose, file)


def _text_points(file: Path) -> Points | None:
    positions, colours = array("d"), array("B")
    for line_number, line in _lines(file):
        fields = line.split(maxsplit=8)
        if not fields:
            continue
        try:
            positions.extend([float(word) for word in fields[1:4]])
            colours.extend([int(word) for word in fields[4:7]])
            float(fields[7])
        except (ValueError, IndexError, OverflowError) as error:
            raise _malformed(file, line_number, line) from error
    if not positions:
        return None
    return Points.of_arrays(np.array(positions).reshape(-1, 3), np.array(colours).reshape(-1, 3))
