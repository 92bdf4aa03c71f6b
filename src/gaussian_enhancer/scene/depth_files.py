"""Depth maps on disk: ``.npy``, ``.npz`` and 16-bit ``.png``.

Axes: h height, w width.
"""

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import load_array
from gaussian_enhancer.scene.photos import read_header

DEPTH_ENDINGS = (".npy", ".npz", ".png")
UNREADABLE = (OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError)


@dataclass(frozen=True)
class ReadDepth:
    """Reads one depth map. Picklable for worker processes.

    Args:
        path: the file; arrays may be (h, w), (1, h, w) or (h, w, 1); ``.npz`` holds ``depth`` or one array.
        scale: scene units of one stored unit (0.001 for millimetres in a scene in metres).
    """

    path: Path
    scale: float = 1.0

    def __call__(self) -> Float[Tensor, "1 h w"]:
        """Z depth in scene units; 0 where the file has NaN or infinity, as renderers write for the background.

        Raises:
            InputError: the file is damaged or has negative depth.
        """
        depth = np.array(_stored(self.path), dtype=np.float32)
        depth[~np.isfinite(depth)] = 0
        if depth.size and depth.min() < 0:
            raise InputError(self.path, f"has depth {depth.min():g}", "write z in front of the camera, 0 for none")
        return torch.from_numpy(depth * np.float32(self.scale))[None]


def depth_size(path: Path) -> tuple[int, int]:
    """Height and width of a depth map, without reading its values where the format allows.

    Raises:
        InputError: the file is missing or damaged.
    """
    if path.suffix.lower() == ".png":
        header = read_header(path)
        return header.height, header.width
    height, width = _stored(path).shape
    return height, width


def find_depth(folder: Path, stem: str) -> Path | None:
    """The depth map of a view in a folder, by the view's name without ending."""
    return next((f for ending in DEPTH_ENDINGS if (f := folder / f"{stem}{ending}").is_file()), None)


def _stored(path: Path) -> np.ndarray:
    if not path.is_file():
        raise InputError(path, "does not exist", "restore the depth map or leave depth out")
    try:
        array = _opened(path)
    except UNREADABLE as error:
        received = f"cannot be read ({path.stat().st_size} bytes: {error})"
        raise InputError(path, received, "write the depth map again") from error
    squeezed = array[0] if array.ndim == 3 and array.shape[0] == 1 else array
    squeezed = squeezed[..., 0] if squeezed.ndim == 3 and squeezed.shape[2] == 1 else squeezed
    if squeezed.ndim != 2 or squeezed.dtype.kind not in "fiu":
        received = f"holds {array.dtype} of shape {array.shape}"
        raise InputError(path, received, "store one number a pixel, shape (height, width)")
    return squeezed


def _opened(path: Path) -> np.ndarray:
    if path.suffix.lower() == ".png":
        from PIL import Image

        with Image.open(path) as image:
            return np.asarray(image)
    return load_array(path, _named)


def _named(names: list[str]) -> str:
    if "depth" not in names and len(names) != 1:
        raise KeyError(f"no array named depth among {names}")
    return "depth" if "depth" in names else names[0]
