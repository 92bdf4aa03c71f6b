"""Niantic's .spz, versions 2 and 3 (one gzip stream) and 4 (a plain header, one zstd stream per attribute; read only).

Attributes in file order: positions (three signed 24-bit fixed-point numbers), opacity (byte), base colour (three bytes,
0.15 a unit of the harmonic coefficient), log scale (three bytes, 1/16 a step from -10), rotation (version 2: x, y, z as
bytes; later: 32-bit words, index of the largest of x, y, z, w, then the others as sign and 9 bits over 1/sqrt(2)),
higher harmonics (bytes around 128, 1/128 a step; colour varies fastest). The axes are right-up-back (OpenGL); they
are rotated by 180 degrees about x to the right-down-forward axes of 3DGS's .ply. Source: the format's own documentation
(nianticlabs/spz, MIT).

Axes: n Gaussians, k spherical-harmonics coefficients.
"""

import gzip
import io
import itertools
import struct
import warnings
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import read_bytes, refuse_larger
from gaussian_enhancer.splat.io.quantised import complete_quaternion, float_tensor, opacity_logits
from gaussian_enhancer.splat.io.validity import refuse_or_drop_invalid
from gaussian_enhancer.types import Gaussians

MAGIC = b"NGSP"
GZIP_MAGIC = b"\x1f\x8b"
_REMEDY = "copy or export the file again"
_LONGEST_EXTENSION = 1 << 24
_WIDEST_WINDOW = 1 << 27
_HARMONICS = (0, 3, 8, 15)  # coefficients above the constant, by degree
# Parity of 3DGS's harmonics (degrees 1 to 3) under (x, y, z) -> (x, -y, -z).
_HALF_TURN = (-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1)


@dataclass(frozen=True)
class _Header:
    """The values in a file's header."""

    version: int
    count: int
    degree: int
    fractional_bits: int
    antialiased: bool
    extended: bool

    @property
    def sizes(self) -> tuple[int, ...]:
        """Size in bytes of each attribute that is not empty, in file order."""
        rotation = 3 if self.version == 2 else 4
        bytes_per_gaussian = (9, 1, 3, 3, rotation, 3 * _HARMONICS[self.degree])
        return tuple(self.count * size for size in bytes_per_gaussian if size)


def read_spz(path: str | Path, *, invalid: str = "refuse") -> Gaussians:
    """Read a .spz of version 2, 3 or 4, float32 on the CPU, in the axes of 3DGS's .ply.

    Args:
        path: the file.
        invalid: what to do with Gaussians that cannot be rendered: "refuse" or "drop".

    Raises:
        InputError: if the file is missing, truncated, of another version, inconsistent, or holds invalid Gaussians that
            are refused.
    """
    data = read_bytes(path)
    if data[:4] == MAGIC:
        header, streams = _read_zstd(path, data)
    elif data[:2] == GZIP_MAGIC:
        header, streams = _read_gzip(path, data)
    else:
        raise InputError(path, f"is no .spz (it starts with {data[:4]!r})", "give a .spz of version 2, 3 or 4")
    if header.antialiased:
        warnings.warn(f"{path}: was trained with anti-aliasing; render it as Mip-Splatting", stacklevel=2)
    if header.extended:
        warnings.warn(f"{path}: has vendor extensions, which are ignored; check its axes", stacklevel=2)
    return refuse_or_drop_invalid(path, _decode(header, streams), invalid)


def _parse_header(path: str | Path, data: bytes, versions: tuple[int, ...]) -> _Header:
    """Parse the first sixteen bytes, which have the same layout in all versions."""
    if len(data) < 16:
        raise InputError(path, f"ends within its header, after {len(data)} bytes", _REMEDY)
    magic, version, count, degree, fractional_bits, flags, _ = struct.unpack_from("<4sIIBBBB", data)
    if magic != MAGIC:
        raise InputError(path, f"is no .spz (it starts with {magic!r})", "give a .spz of version 2, 3 or 4")
    if version not in versions:
        raise InputError(path, f"is of version {version}", "convert it to version 2, 3 or 4")
    if count == 0:
        raise InputError(path, "holds no Gaussians", "export the splat again")
    if degree >= len(_HARMONICS):
        raise InputError(path, f"has harmonics of degree {degree}", "export it with degree 3 or less")
    if fractional_bits > 24:
        raise InputError(path, f"has {fractional_bits} fractional bits where positions have 24", _REMEDY)
    header = _Header(version, count, degree, fractional_bits, bool(flags & 1), bool(flags & 2))
    refuse_larger(path, count * (320 + 64 * _HARMONICS[degree]), f"announces {count} Gaussians of degree {degree}")
    return header


def _read_gzip(path: str | Path, data: bytes) -> tuple[_Header, list[bytes]]:
    """Read versions 2 and 3: the header and the attributes, one after the other, in one gzip stream."""
    try:
        with gzip.open(io.BytesIO(data)) as stream:
            header = _parse_header(path, stream.read(16), (2, 3))
            required_size = sum(header.sizes)
            body = stream.read(required_size)
            # gzip verifies the checksum when the stream is read to its end.
            extra = len(stream.read(_LONGEST_EXTENSION + 1 if header.extended else 1))
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(path, f"is truncated or damaged ({error})", _REMEDY) from None
    if len(body) < required_size or extra > (_LONGEST_EXTENSION if header.extended else 0):
        received = f"holds {len(body)} bytes" if len(body) < required_size else f"holds more than {required_size} bytes"
        raise InputError(path, f"{received} where {header.count} Gaussians need {required_size}", _REMEDY)
    offsets = list(itertools.accumulate(header.sizes, initial=0))
    return header, [body[start:end] for start, end in itertools.pairwise(offsets)]


def _read_zstd(path: str | Path, data: bytes) -> tuple[_Header, list[bytes]]:
    """Read version 4: a header of 32 bytes, a table of (compressed, full) sizes, and the zstd streams."""
    header = _parse_header(path, data, (4,))
    if len(data) < 32:
        raise InputError(path, f"ends within its header, after {len(data)} bytes", _REMEDY)
    stream_count, (table,) = data[15], struct.unpack_from("<I", data, 16)
    start = table + 16 * stream_count
    if table < 32 or len(data) < start:
        raise InputError(path, f"ends within its table of streams, after {len(data)} bytes", _REMEDY)
    sizes = [struct.unpack_from("<QQ", data, table + 16 * i) for i in range(stream_count)]
    sizes = [(packed_size, full_size) for packed_size, full_size in sizes if full_size]
    full_sizes = [full_size for _, full_size in sizes]
    if tuple(full_sizes) != header.sizes:
        received = f"has streams of {full_sizes} bytes where {header.count} Gaussians need {list(header.sizes)}"
        raise InputError(path, received, _REMEDY)
    required_size = start + sum(packed_size for packed_size, _ in sizes)
    if len(data) < required_size:
        raise InputError(path, f"is truncated after {len(data)} of {required_size} bytes", _REMEDY)
    offsets = itertools.accumulate((packed_size for packed_size, _ in sizes), initial=start)
    frames = (data[begin:end] for begin, end in itertools.pairwise(offsets))
    return header, [_decompress(path, frame, full_size) for frame, (_, full_size) in zip(frames, sizes, strict=True)]


def _decompress(path: str | Path, frame: bytes, size: int) -> bytes:
    """Decompress a zstd frame that must hold ``size`` bytes."""
    import zstandard

    try:
        claimed_size = zstandard.get_frame_parameters(frame).content_size
        if claimed_size not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise InputError(path, f"has a stream of {claimed_size} bytes instead of {size}", _REMEDY)
        stream = zstandard.ZstdDecompressor(max_window_size=_WIDEST_WINDOW).decompress(frame, max_output_size=size)
    except zstandard.ZstdError as error:
        raise InputError(path, f"is damaged ({error})", _REMEDY) from None
    if len(stream) != size:
        raise InputError(path, f"has a stream of {len(stream)} bytes instead of {size}", _REMEDY)
    return stream


def _decode(header: _Header, streams: list[bytes]) -> Gaussians:
    """Decode the attributes to numbers in the axes of 3DGS's .ply."""
    count, higher_count = header.count, _HARMONICS[header.degree]
    position, opacity, colour, scale, rotation = (np.frombuffer(stream, np.uint8) for stream in streams[:5])
    sh = ((colour.reshape(count, 1, 3) / 255.0) - 0.5) / 0.15
    if higher_count:
        stored_harmonics = np.frombuffer(streams[5], np.uint8).reshape(count, higher_count, 3)
        sh = np.concatenate([sh.astype(np.float32), (stored_harmonics.astype(np.float32) - 128.0) / 128.0], axis=1)
    means = _fixed_point(position.reshape(count, 3, 3)) / float(1 << header.fractional_bits)
    quaternions = _rotations(header.version, rotation.reshape(count, -1))
    file_gaussians = Gaussians(
        means=float_tensor(means),
        log_scales=float_tensor(scale.reshape(count, 3) / 16.0 - 10.0),
        quaternions=float_tensor(quaternions),
        opacity_logits=float_tensor(opacity_logits(opacity)),
        sh=float_tensor(sh),
    )
    return half_turn(file_gaussians)


def half_turn(gaussians: Gaussians) -> Gaussians:
    """Rotate a splat by 180 degrees about x: from the axes of .spz to those of 3DGS's .ply, or back.

    Args:
        gaussians: the splat, of degree 3 at most.
    """
    signs = gaussians.sh.new_tensor((1, *_HALF_TURN))[: gaussians.sh.shape[1], None]
    return replace(
        gaussians,
        means=gaussians.means * gaussians.means.new_tensor((1.0, -1.0, -1.0)),
        quaternions=gaussians.quaternions * gaussians.quaternions.new_tensor((1.0, 1.0, -1.0, -1.0)),
        sh=gaussians.sh * signs,
    )


def _fixed_point(stored: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """Decode signed 24-bit little-endian integers from bytes of shape (n, 3, 3)."""
    padded = np.zeros((*stored.shape[:2], 4), np.uint8)
    padded[..., 1:] = stored  # the upper three bytes of 32 bits, so that the right shift extends the sign
    return (padded.view("<i4")[..., 0] >> 8).astype(np.float64)


def _rotations(version: int, stored: np.ndarray) -> Float[np.ndarray, "n 4"]:
    """Quaternions (w, x, y, z) in the file's axes."""
    if version == 2:
        components = stored / 127.5 - 1.0
        return complete_quaternion(components, np.zeros(len(stored), np.int64))
    packed = np.ascontiguousarray(stored).view("<u4")[:, 0]
    fields = np.stack([(packed >> np.uint32(shift)) & np.uint32(1023) for shift in (20, 10, 0)], axis=1)
    magnitude = (fields & np.uint32(511)) / 511.0 * np.sqrt(0.5)
    components = np.where(fields & np.uint32(512), -magnitude, magnitude)
    xyzw = complete_quaternion(components, (packed >> np.uint32(30)).astype(np.int64))
    return xyzw[:, [3, 0, 1, 2]]
