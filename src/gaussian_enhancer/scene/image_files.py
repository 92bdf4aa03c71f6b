"""Writing of enhanced images."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import whole_file

RUN_LENGTHS = 3
"""zlib's strategy Z_RLE, which looks for runs alone: several times as fast as the default on photos, and files are a
few percent larger (docs/performance.md)."""


def write_image(path: Path, image: Float[Tensor, "3 h w"]) -> None:
    """Write an 8-bit image in the format that its ending asks for, whole or not at all.

    Args:
        path: .png, or another ending that PIL writes; lossy formats are written at quality 95.
        image: colours; what lies outside [0, 1] is clamped.

    Raises:
        InputError: the disk is full, the folder cannot be written, or the ending is unknown.
    """
    values = np.ascontiguousarray((image.clamp(0, 1) * 255).round().byte().permute(1, 2, 0).cpu().numpy())
    if path.suffix.lower() not in Image.registered_extensions():
        raise InputError(path, f"ends in {path.suffix!r}, which no image format has", "name it .png")
    lossy = path.suffix.lower() in (".jpg", ".jpeg", ".webp")
    with whole_file(path) as temporary:
        picture = Image.fromarray(values)
        if lossy:
            picture.save(temporary, quality=95)
        elif path.suffix.lower() in (".png", ".apng"):
            picture.save(temporary, compress_type=RUN_LENGTHS)
        else:
            picture.save(temporary)
