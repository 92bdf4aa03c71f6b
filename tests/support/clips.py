"""Small videos with sound."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch

av = pytest.importorskip("av", reason="PyAV is in the dependency group `test`")

VP9 = {"crf": "10", "b:v": "0", "deadline": "realtime", "cpu-used": "8"}
GREYS = (0.1, 0.3, 0.5, 0.7, 0.9, 0.2)
"""The frames of a clip, each of one grey."""


def write_clip(path: Path, sound: str | None = None, frames: list[np.ndarray] | None = None) -> Path:
    """A video of grey frames of 64x48 pixels, ten a second, with a tone.

    Args:
        path: the file, ending in .mp4 or .webm.
        sound: encoder of the tone; None writes none.
        frames: (h, w, 3) bytes in place of the grey frames.
    """
    shown = frames or [np.full((48, 64, 3), round(255 * grey), np.uint8) for grey in GREYS]
    codec = "libx264" if path.suffix == ".mp4" else "libvpx-vp9"
    with av.open(str(path), "w") as container:
        video = container.add_stream(codec, rate=10)
        video.height, video.width, video.pix_fmt = *shown[0].shape[:2], "yuv420p"
        video.codec_context.options = VP9 if codec == "libvpx-vp9" else {"crf": "10"}
        audio = None if sound is None else container.add_stream(sound, rate=48000)
        for values in shown:
            container.mux(video.encode(av.VideoFrame.from_ndarray(values, format="rgb24")))
        container.mux(video.encode(None))
        if audio is not None:
            tone = np.sin(np.arange(4800 * len(shown)) / 20).astype(np.float32)
            heard = av.AudioFrame.from_ndarray(tone[None], format="fltp", layout="mono")
            heard.sample_rate, heard.pts, heard.time_base = 48000, 0, Fraction(1, 48000)
            container.mux(audio.encode(heard))
            container.mux(audio.encode(None))
    return path


def heard(path: Path) -> list[bytes]:
    """The packets of a video's sound."""
    with av.open(str(path)) as source:
        return [bytes(packet) for packet in source.demux(source.streams.audio[0]) if packet.size]


def decoded(path: Path) -> list[torch.Tensor]:
    """The frames of a video, (3, h, w) in [0, 1]."""
    with av.open(str(path)) as source:
        return [
            torch.from_numpy(frame.to_ndarray(format="rgb24")).permute(2, 0, 1) / 255
            for frame in source.decode(video=0)
        ]
