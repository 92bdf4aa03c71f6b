"""Quantisation to 8-bit pixels, and writing of image files.

Axes: c channels, h height, w width.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import Image
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write
from gaussian_enhancer.scene.png import encode_png
from gaussian_enhancer.types import numpy_view


def write_image(path: Path, image: Float[Tensor, "c h w"]) -> None:
    """Write an 8-bit image atomically, in the format of the path's ending.

    Args:
        path: file ending in .png or another ending known to PIL; JPEG and WebP are written at quality 95.
        image: three colours, or one channel for a grey image; values outside [0, 1] are clamped.

    Raises:
        InputError: the disk is full, the folder is not writable, or the ending is unknown.
    """
    if path.suffix.lower() not in Image.registered_extensions():
        raise InputError(path, f"ends in {path.suffix!r}, which no image format has", "name it .png")
    lossy = path.suffix.lower() in (".jpg", ".jpeg", ".webp")
    values = to_bytes(image)
    grey = values.shape[-1] == 1
    with atomic_write(path) as temporary:
        if path.suffix.lower() == ".png" and not grey:
            temporary.write_bytes(encode_png(values))
        else:
            options: dict[str, Any] = {"quality": 95} if lossy else {"compress_level": 3}  # the latter is PNG's only
            Image.fromarray(values[..., 0] if grey else values).save(temporary, **options)


def to_bytes(image: Float[Tensor, "c h w"]) -> UInt8[np.ndarray, "h w c"]:
    """8-bit pixels of an image: clamped to [0, 1], scaled to 255 and rounded, ties to even.

    Args:
        image: colours, on any device.
    """
    if image.device.type != "cpu" or image.dtype != torch.float32:
        return np.ascontiguousarray((image.clamp(0, 1) * 255).round().byte().permute(1, 2, 0).cpu().numpy())
    from gaussian_enhancer.compiled import kernel_lock
    from gaussian_enhancer.scene.image_kernels import quantise

    channels, height, width = image.shape
    pixels = np.empty((height, width, channels), np.uint8)
    with kernel_lock:
        quantise(numpy_view(image), pixels)
    return pixels
