"""Depth maps on disk: ``.npy``, ``.npz`` and 16-bit ``.png``.

Axes: h height, w width.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import array_header, load_array
from gaussian_enhancer.input_files import convert_decoder_errors, refuse_larger, regular_file
from gaussian_enhancer.scene.photos import open_image
from gaussian_enhancer.types import FARTHEST_DEPTH

DEPTH_ENDINGS = (".npy", ".npz", ".png")
PNG_MODES = ("I;16", "I;16B", "I;16L", "I", "L")
REMEDY = "write the depth map again"


@dataclass(frozen=True)
class ReadDepth:
    """Callable that reads one depth map. Picklable for worker processes.

    Args:
        path: the file. Arrays have shape (h, w), (1, h, w) or (h, w, 1); an ``.npz`` file holds an array ``depth`` or a
            single array of any name.
        scale: scene units per stored unit (0.001 for millimetres in a scene in metres).

    Raises:
        InputError: the scale is not a finite positive number.
    """

    path: Path
    scale: float = 1.0

    def __post_init__(self) -> None:
        is_number = isinstance(self.scale, int | float) and not isinstance(self.scale, bool)
        if not (is_number and 0 < self.scale < math.inf):
            raise InputError("depth_scale", f"is {self.scale}", "give the scene units of one stored unit, above 0")

    def __call__(self) -> Float[Tensor, "1 h w"]:
        """Z depth in scene units; 0 where the file has NaN or infinity, which renderers write for the background.

        Raises:
            InputError: the file is damaged or exceeds the size limit, or depth is negative or above `FARTHEST_DEPTH`.
        """
        stored = _read_stored(self.path)
        depth = np.where(np.isfinite(stored), stored, 0) * np.float64(self.scale)
        if depth.size and depth.min() < 0:
            raise InputError(self.path, f"has depth {depth.min():g}", "write z in front of the camera, 0 for none")
        if depth.size and depth.max() > FARTHEST_DEPTH:
            raise InputError(self.path, f"has depth {depth.max():g}", "write 0 where nothing was hit")
        return torch.from_numpy(depth.astype(np.float32))[None]


def depth_size(path: Path) -> tuple[int, int]:
    """Height and width of a depth map, from the file's header.

    Raises:
        InputError: the file is missing, damaged or too large, or is not a depth map.
    """
    _, shape = _file_shape(path)
    height, width = _squeeze(shape)
    return height, width


def find_depth(folder: Path, stem: str) -> Path | None:
    """Path of the depth map in a folder for the view named ``stem`` (without ending); None if there is none."""
    return next((f for ending in DEPTH_ENDINGS if (f := folder / f"{stem}{ending}").is_file()), None)


def _file_shape(path: Path) -> tuple[bool, tuple[int, ...]]:
    """Whether the file is an image, and the shape in its header, once checked against the size limit."""
    regular_file(path)
    if path.suffix.lower() == ".png":
        with open_image(path) as image:
            if image.mode not in PNG_MODES:
                raise InputError(path, f"is an image of mode {image.mode}", "save depth as grey PNG of 16 bits")
            return True, (image.height, image.width)
    with convert_decoder_errors(path, REMEDY):
        shape, dtype = array_header(path, _choose_array)
    if len(_squeeze(shape)) != 2 or dtype.kind not in "fiu":
        raise InputError(path, f"holds {dtype} of shape {shape}", "store one number a pixel, shape (height, width)")
    # Bytes per pixel: as stored, masked, scaled in float64, and as float32.
    refuse_larger(path, math.prod(shape) * (dtype.itemsize + 8 + 8 + 4), f"is a depth map of shape {shape}")
    return False, shape


def _squeeze(shape: tuple[int, ...]) -> tuple[int, ...]:
    shape = shape[1:] if len(shape) == 3 and shape[0] == 1 else shape
    return shape[:2] if len(shape) == 3 and shape[2] == 1 else shape


def _read_stored(path: Path) -> np.ndarray:
    is_image, shape = _file_shape(path)
    if is_image:
        with open_image(path) as image, convert_decoder_errors(path, REMEDY):
            return np.asarray(image)
    with convert_decoder_errors(path, REMEDY):
        return np.asarray(load_array(path, _choose_array)).reshape(_squeeze(shape))


def _choose_array(names: list[str]) -> str:
    if "depth" not in names and len(names) != 1:
        raise KeyError(f"no array named depth among {names}")
    return "depth" if "depth" in names else names[0]
