"""Reading of the frames of a video file.

Axes: h height, w width.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.video.encode import load_pyav

REMEDY = "give a video that FFmpeg can read"


class Clip:
    """The frames of a video file, decoded in order. For an earlier frame, decoding starts again at the first.

    Args:
        path: the file.

    Raises:
        InputError: PyAV is not installed, or the file cannot be read or has no video stream.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._library = load_pyav()
        if not self.path.is_file():
            raise InputError(self.path, "does not exist", "give a video file")
        try:
            with self._library.open(str(self.path)) as source:
                stream = source.streams.video[0]
                self.height, self.width = int(stream.height), int(stream.width)
                self.fps = float(stream.average_rate or stream.guessed_rate)
                self.sound = tuple(str(audio.codec_context.name) for audio in source.streams.audio)
                self.count = sum(packet.size > 0 for packet in source.demux(stream))
        except (OSError, IndexError, TypeError, ValueError) as error:
            raise InputError(self.path, f"cannot be read as a video ({error})", REMEDY) from error
        self._frames, self._next = self._decode(), 0

    def frame(self, index: int) -> Float[Tensor, "3 h w"]:
        """The colours of a frame, [0, 1].

        Args:
            index: 0 for the first.

        Raises:
            InputError: the file has no such frame, or is damaged there.
        """
        if index < self._next:
            self._frames, self._next = self._decode(), 0
        try:
            for picture in self._frames:
                self._next += 1
                if self._next > index:
                    return torch.from_numpy(picture.to_ndarray(format="rgb24")).permute(2, 0, 1).float() / 255
        except (OSError, ValueError) as error:  # PyAV's errors are of either kind
            raise InputError(self.path, f"is damaged at frame {index} ({error})", REMEDY) from error
        raise InputError(self.path, f"has no frame {index}", f"it has {self.count}")

    def _decode(self) -> Iterator[Any]:
        with self._library.open(str(self.path)) as source:
            yield from source.decode(video=0)
