"""Enhanced frames on disk, from which an interrupted video is resumed.

Axes: h height, w width.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxtyping import Float
from PIL import Image, PngImagePlugin
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write
from gaussian_enhancer.scene.image_files import to_bytes
from gaussian_enhancer.scene.photos import read_photo

CANDIDATES = "candidates"
"""Key of the PNG text chunk that lists the references considered for a frame."""


def frame_name(index: int) -> str:
    """The file name of a frame.

    Args:
        index: 0 for the first.
    """
    return f"frame_{index:06d}.png"


@dataclass(frozen=True)
class FrameFolder:
    """A folder of enhanced frames. Each is written atomically, with the names of the references considered for it.

    Args:
        folder: path of the folder, which need not exist.
    """

    folder: Path

    def has(self, index: int) -> bool:
        """Whether a frame is on disk."""
        return (self.folder / frame_name(index)).is_file()

    def write(self, index: int, image: Float[Tensor, "3 h w"], candidates: Sequence[str] = ()) -> None:
        """Write a frame in 8 bits.

        Args:
            index: index of the frame.
            image: colours of the frame, [0, 1].
            candidates: names of the references considered for the frame.

        Raises:
            InputError: the disk is full, or the folder cannot be written.
        """
        values = to_bytes(image)
        png_info = PngImagePlugin.PngInfo()
        png_info.add_text(CANDIDATES, json.dumps(list(candidates)))
        with atomic_write(self.folder / frame_name(index)) as temporary:
            Image.fromarray(values).save(temporary, compress_level=3, pnginfo=png_info)

    def read(self, index: int) -> Float[Tensor, "3 h w"]:
        """Read a frame.

        Raises:
            InputError: it is missing or damaged.
        """
        return read_photo(self.folder / frame_name(index))

    def candidates(self, index: int) -> tuple[str, ...]:
        """Names of the references considered for a frame.

        Raises:
            InputError: the frame cannot be read, or has no such list.
        """
        path = self.folder / frame_name(index)
        try:
            with Image.open(path) as image:
                names = json.loads(str(image.info[CANDIDATES]))
        except (OSError, KeyError, ValueError) as error:
            raise InputError(path, f"is no frame of an enhanced video ({error})", "delete it") from error
        return tuple(map(str, names))
