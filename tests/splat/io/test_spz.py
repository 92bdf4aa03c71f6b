import gzip
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import torch
import zstandard

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.io.spz import read_spz

COEFFICIENTS = (0, 3, 8, 15)


def attributes(version: int, degree: int, count: int = 6) -> list[bytes]:
    draw = np.random.default_rng(version * 10 + degree)
    sizes = (9, 1, 3, 3, 3 if version == 2 else 4, 3 * COEFFICIENTS[degree])
    return [draw.integers(0, 256, count * size, dtype=np.uint8).tobytes() for size in sizes if size]


def header(version: int, degree: int, count: int, flags: int = 0, streams: int = 0) -> bytes:
    return struct.pack("<4sIIBBBB", b"NGSP", version, count, degree, 12, flags, streams)


def packed(version: int, degree: int, parts: list[bytes], count: int = 6, flags: int = 0, extra: bytes = b"") -> bytes:
    """A whole file of any version; ``extra`` are extension records."""
    if version < 4:
        return gzip.compress(header(version, degree, count, flags) + b"".join(parts) + extra)
    streams = [zstandard.ZstdCompressor().compress(part) for part in parts]
    table = b"".join(struct.pack("<QQ", len(s), len(p)) for s, p in zip(streams, parts, strict=True))
    start = struct.pack("<I12x", 32 + len(extra))
    return header(version, degree, count, flags, len(parts)) + start + extra + table + b"".join(streams)


@pytest.mark.parametrize("version", [2, 3, 4])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_bytes_are_decoded_by_hand_calculation(tmp_path: Path, version: int, degree: int) -> None:
    parts = attributes(version, degree)
    parts[0] = b"\x00\x10\x00" + b"\x00\xf0\xff" + b"\x00\x20\x00" + parts[0][9:]  # 1, -1, 2 at 12 bits
    parts[1] = bytes([51]) + parts[1][1:]
    parts[2] = bytes([255, 0, 51]) + parts[2][3:]
    parts[3] = bytes([0, 160, 255]) + parts[3][3:]
    (tmp_path / "a.spz").write_bytes(packed(version, degree, parts))
    read = read_spz(tmp_path / "a.spz")
    assert read.means[0].tolist() == [1.0, 1.0, -2.0]  # y and z are turned round
    assert torch.sigmoid(read.opacity_logits[0]).item() == pytest.approx(0.2, abs=1e-6)
    np.testing.assert_allclose(read.sh[0, 0].numpy(), [0.5 / 0.15, -0.5 / 0.15, -0.3 / 0.15], rtol=1e-5)
    assert read.log_scales[0].tolist() == [-10.0, 0.0, 5.9375]
    assert read.sh.shape == (6, 1 + COEFFICIENTS[degree], 3)


def test_rotations_of_version_2_are_bytes_of_x_y_z(tmp_path: Path) -> None:
    parts = attributes(2, 0)
    parts[4] = bytes([204, 127, 127]) + parts[4][3:]  # x = 0.6, y and z = -1/255
    (tmp_path / "a.spz").write_bytes(packed(2, 0, parts))
    expected = [0.8, 0.6, 1 / 255, 1 / 255]
    np.testing.assert_allclose(read_spz(tmp_path / "a.spz").quaternions[0].numpy(), expected, atol=1e-4)


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("largest", [0, 1, 2, 3])
def test_later_rotations_are_the_smallest_three(tmp_path: Path, version: int, largest: int) -> None:
    stored = np.array([0.1, -0.3, 0.2])
    fields = [round(abs(v) / np.sqrt(0.5) * 511) | (512 if v < 0 else 0) for v in stored]
    word = (largest << 30) | (fields[0] << 20) | (fields[1] << 10) | fields[2]
    parts = attributes(version, 0)
    parts[4] = struct.pack("<I", word) + parts[4][4:]
    (tmp_path / "a.spz").write_bytes(packed(version, 0, parts))
    x, y, z, w = np.insert(stored, largest, np.sqrt(1 - (stored**2).sum()))
    np.testing.assert_allclose(read_spz(tmp_path / "a.spz").quaternions[0].numpy(), [w, x, -y, -z], atol=2e-3)


def harmonics(d: np.ndarray) -> np.ndarray:
    """The fifteen harmonics above the constant as 3DGS orders them, up to positive factors."""
    x, y, z = d.T
    xx, yy, zz = x * x, y * y, z * z
    first = [-y, z, -x]
    second = [x * y, -y * z, 2 * zz - xx - yy, -x * z, xx - yy]
    third = [-y * (3 * xx - yy), x * y * z, -y * (4 * zz - xx - yy), z * (2 * zz - 3 * xx - 3 * yy)]
    third += [-x * (4 * zz - xx - yy), z * (xx - yy), -x * (xx - 3 * yy)]
    return np.stack(first + second + third, axis=1)


def test_the_colour_turns_with_the_axes(tmp_path: Path) -> None:
    parts = attributes(4, 3)
    (tmp_path / "a.spz").write_bytes(packed(4, 3, parts))
    read = read_spz(tmp_path / "a.spz").sh[:, 1:].numpy()
    stored = (np.frombuffer(parts[5], np.uint8).reshape(6, 15, 3) - 128.0) / 128.0
    directions = np.random.default_rng(0).standard_normal((20, 3))
    before = np.einsum("dk,nkc->dnc", harmonics(directions * [1, -1, -1]), stored)
    after = np.einsum("dk,nkc->dnc", harmonics(directions), read)
    np.testing.assert_allclose(after, before, atol=1e-5)


@pytest.mark.parametrize("version", [2, 3, 4])
def test_extensions_are_passed_over_aloud_and_antialiasing_is_told(tmp_path: Path, version: int) -> None:
    record = struct.pack("<II4s", 0xADBE0002, 4, b"four")
    (tmp_path / "a.spz").write_bytes(packed(version, 1, attributes(version, 1), flags=3, extra=record))
    with pytest.warns(UserWarning, match=r"a\.spz") as told:
        assert len(read_spz(tmp_path / "a.spz")) == 6
    assert ["Mip-Splatting" in str(w.message) or "extensions" in str(w.message) for w in told] == [True, True]


@pytest.mark.parametrize("version", [2, 3, 4])
def test_every_truncation_is_refused_by_name(tmp_path: Path, version: int) -> None:
    whole = packed(version, 1, attributes(version, 1))
    for keep in range(0, len(whole), 7):
        (tmp_path / "a.spz").write_bytes(whole[:keep])
        with pytest.raises(InputError, match=r"a\.spz: "):
            read_spz(tmp_path / "a.spz")


@pytest.mark.parametrize("version", [2, 3, 4])
@pytest.mark.parametrize("count", [5, 7, 2**32 - 1])
def test_a_count_that_does_not_fit_is_refused(tmp_path: Path, version: int, count: int) -> None:
    (tmp_path / "a.spz").write_bytes(packed(version, 1, attributes(version, 1), count=count))
    with pytest.raises(InputError, match=r"bytes where|announces"):
        read_spz(tmp_path / "a.spz")


def test_no_gaussians_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.spz").write_bytes(packed(3, 0, [], count=0))
    with pytest.raises(InputError, match="holds no Gaussians"):
        read_spz(tmp_path / "a.spz")


@pytest.mark.parametrize(("version", "degree", "found"), [(1, 0, "version 1"), (5, 0, "version 5"), (3, 4, "degree 4")])
def test_what_is_not_supported_is_named(tmp_path: Path, version: int, degree: int, found: str) -> None:
    data = header(version, degree, 1)
    (tmp_path / "a.spz").write_bytes(gzip.compress(data) if version < 4 else data + bytes(16))
    with pytest.raises(InputError, match=found):
        read_spz(tmp_path / "a.spz")


def test_damaged_streams_are_refused(tmp_path: Path) -> None:
    for version in (2, 4):
        whole = bytearray(packed(version, 3, attributes(version, 3, 60), count=60))
        whole[-200] ^= 0xFF
        whole[-30] ^= 0xFF
        (tmp_path / "a.spz").write_bytes(bytes(whole))
        if version == 2:  # gzip has a checksum; a zstd frame of incompressible bytes need not notice
            with pytest.raises(InputError, match="damaged"):
                read_spz(tmp_path / "a.spz")


def peak_of_refusal(path: Path, message: str) -> int:
    """Bytes that Python allocated at most while a file was refused."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=message):
            read_spz(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_a_gzip_bomb_is_read_only_as_far_as_its_header_says(tmp_path: Path) -> None:
    bomb = gzip.compress(header(3, 1, 6) + bytes(300_000_000))
    (tmp_path / "a.spz").write_bytes(bomb)
    assert peak_of_refusal(tmp_path / "a.spz", "holds more than 174 bytes") < 10 * len(bomb)


def test_a_zstd_bomb_is_not_unpacked(tmp_path: Path) -> None:
    whole = packed(4, 1, attributes(4, 1))
    bomb = zstandard.ZstdCompressor().compress(bytes(300_000_000))
    start = 32 + 16 * whole[15]
    (tmp_path / "a.spz").write_bytes(whole[:32] + struct.pack("<Q", len(bomb)) + whole[40:start] + bomb + whole[start:])
    assert peak_of_refusal(tmp_path / "a.spz", "has a stream of 300000000 bytes instead of 54") < 1_000_000


def test_what_is_announced_is_more_than_what_is_taken(tmp_path: Path) -> None:
    count, degree = 20_000, 3
    (tmp_path / "a.spz").write_bytes(packed(3, degree, attributes(3, degree, count), count=count))
    tracemalloc.start()
    read_spz(tmp_path / "a.spz")
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert taken < count * (320 + 64 * COEFFICIENTS[degree])
