"""Encoding of frames by PyAV, which includes FFmpeg's libraries.

Axes: h height, w width.
"""

import heapq
import io
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write, to_write_error
from gaussian_enhancer.optional_library import optional_library
from gaussian_enhancer.scene.image_files import to_bytes

CODECS = {"mp4": "libx264", "webm": "libvpx-vp9"}
"""The encoder of each container."""
BT709 = 1
"""FFmpeg's number for the colour space ITU-R BT.709, which players assume for videos that state none."""
LIMITED = 1
"""FFmpeg's number for limited range: luma from 16 to 235."""


@dataclass(frozen=True)
class Encoding:
    """How frames are encoded.

    Args:
        container: "mp4" (H.264) or "webm" (VP9).
        fps: frames per second, above 0 and at most 1,000.
        quality: constant rate factor: lower is better and larger; 0 to 51 for mp4, 0 to 63 for webm.

    Raises:
        InputError: a value is out of range.
    """

    container: str = "mp4"
    fps: int | float = 30
    quality: int = 18

    def __post_init__(self) -> None:
        if self.container not in CODECS:
            raise InputError("format", f"is {self.container!r}", f"choose {', '.join(CODECS)} or frames")
        if not 0 < self.fps <= 1000:
            raise InputError("fps", f"is {self.fps!r}", "give frames a second, above 0 to 1000")
        largest = 51 if self.container == "mp4" else 63
        if not 0 <= self.quality <= largest:
            raise InputError("quality", f"is {self.quality!r}", f"give a whole number from 0 (best) to {largest}")

    def check(self, sound: Sequence[str] = ()) -> None:
        """Check that the encoder exists and that the container can hold the sound without re-encoding.

        It is called before anything is rendered.

        Args:
            sound: codecs of the sound that is copied into the video.

        Raises:
            InputError: PyAV is not installed, its FFmpeg has no such encoder, or the container holds no such sound.
        """
        library = load_pyav()
        name = CODECS[self.container]
        alternatives = ", ".join(choice for choice in CODECS if choice != self.container)
        try:
            library.codec.Codec(name, "w")
        except (ValueError, library.error.FFmpegError) as error:
            received = f"needs the encoder {name}, which this build of PyAV lacks"
            raise InputError(f"format={self.container}", received, f"choose format={alternatives} or frames") from error
        if not sound:
            return
        with library.open(io.BytesIO(), "w", format=self.container) as container:
            supported = container.supported_codecs
        for name in (name for name in sound if name not in supported):
            received = f"cannot hold sound in {name}, which the input has"
            raise InputError(f"format={self.container}", received, f"choose format={alternatives} or frames")


class VideoWriter:
    """Context manager that writes frames to a video file as they come.

    The file is written in fragments of about two seconds. After the process is killed, the fragments that were written
    are playable. After the block ends early, by an error or Ctrl-C, all frames passed to `write` are playable. `finish`
    converts the fragments to an ordinary file.

    Args:
        path: the file that is written in fragments; an existing one is replaced.
        encoding: container, frames per second, quality.
        height: height of the frames in pixels, even.
        width: width of the frames in pixels, even.

    Raises:
        InputError: the file cannot be written.
    """

    def __init__(self, path: Path, encoding: Encoding, height: int, width: int) -> None:
        library = load_pyav()
        self.path, self.encoding = path, encoding
        options = {"flush_packets": "1"}  # write packets at once: a fragment without its end would not be playable
        if encoding.container == "mp4":
            options["movflags"] = "frag_keyframe+empty_moov+default_base_moof"
        self._frames = 0
        with _write_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._container = library.open(str(path), "w", format=encoding.container, options=options)
        rate = Fraction(encoding.fps).limit_denominator(1001)
        stream: Any = self._container.add_stream(CODECS[encoding.container], rate=rate)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        context = stream.codec_context
        context.gop_size = max(1, round(2 * encoding.fps))
        context.colorspace = context.color_primaries = context.color_trc = BT709
        context.color_range = LIMITED
        context.options = {"crf": str(encoding.quality), **_speed(encoding.container)}
        self._stream = stream

    def __enter__(self) -> "VideoWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with _write_errors(self.path):
            try:
                self._container.mux(self._stream.encode(None))
            finally:
                self._container.close()

    def write(self, frame: Float[Tensor, "3 h w"]) -> None:
        """Add a frame.

        Args:
            frame: its colours, [0, 1].

        Raises:
            InputError: the disk is full, or the file cannot be written.
        """
        picture: Any = load_pyav().VideoFrame.from_ndarray(to_bytes(frame), format="rgb24")
        picture = picture.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
        picture.pts, self._frames = self._frames, self._frames + 1
        with _write_errors(self.path):
            self._container.mux(self._stream.encode(picture))

    def finish(self, path: Path, sound: Path | None = None) -> None:
        """Convert the fragments to an ordinary, seekable file, and remove them. Call it after the block has ended.

        Args:
            path: the file to write, atomically.
            sound: a video whose sound is copied without re-encoding; None for a silent video.

        Raises:
            InputError: the disk is full, or the file cannot be written.
        """
        library = load_pyav()
        options = {"movflags": "faststart"} if self.encoding.container == "mp4" else {}
        with atomic_write(path) as temporary, _write_errors(path), ExitStack() as files:
            streams = [files.enter_context(library.open(str(self.path))).streams.video[0]]
            if sound is not None:
                streams += files.enter_context(library.open(str(sound))).streams.audio
            target = files.enter_context(
                library.open(str(temporary), "w", format=self.encoding.container, options=options)
            )
            copies = [(stream, target.add_stream_from_template(stream)) for stream in streams]
            for packet, target_stream in heapq.merge(*(_packets(*pair) for pair in copies), key=_decoding_time):
                packet.stream = target_stream
                target.mux(packet)
        self.path.unlink(missing_ok=True)


@contextmanager
def _write_errors(path: Path) -> Iterator[None]:
    """Convert system errors inside the context to an `InputError` about the file that is written."""
    try:
        yield
    except OSError as error:
        raise to_write_error(path, error) from error


def _packets(source: Any, target: Any) -> Iterator[tuple[Any, Any]]:
    """The packets of a source stream, each with the target stream that it is copied to."""
    for packet in source.container.demux(source):
        if packet.dts is not None:
            yield packet, target


def _decoding_time(packet_and_target: tuple[Any, Any]) -> float:
    """Decoding time of a packet in seconds."""
    packet, _ = packet_and_target
    return float(packet.dts * packet.time_base)


def _speed(container: str) -> dict[str, str]:
    """Encoder options for speed. VP9 needs them, since its defaults take seconds per frame."""
    return {"b:v": "0", "deadline": "good", "cpu-used": "4", "row-mt": "1"} if container == "webm" else {}


def load_pyav() -> Any:
    """Import PyAV, an optional library.

    Raises:
        InputError: it is not installed.
    """
    return optional_library("av", "video", "video", name="PyAV", otherwise="choose format=frames")
