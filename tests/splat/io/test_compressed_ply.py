from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.io.compressed_ply import read_compressed_ply

AXES = ("x", "y", "z", "scale_x", "scale_y", "scale_z", "r", "g", "b")


def elements(count: int = 300, harmonics: int = 9) -> dict[str, np.ndarray]:
    """A file's elements with random words; ranges differ from chunk to chunk."""
    draw = np.random.default_rng(count + harmonics)
    chunks = -(-count // 256)
    chunk = np.empty(chunks, dtype=[(f"{end}_{axis}", "f4") for axis in AXES for end in ("max", "min")])
    for axis in AXES:
        low = draw.uniform(-3, 0, chunks)
        chunk[f"min_{axis}"], chunk[f"max_{axis}"] = low, low + draw.uniform(0.5, 2, chunks)
    names = ("packed_color", "packed_scale", "packed_rotation", "packed_position")
    vertex = np.empty(count, dtype=[(name, "u4") for name in names])
    for name in names:
        vertex[name] = draw.integers(0, 2**32, count, dtype=np.uint32)
    found = {"chunk": chunk, "vertex": vertex}
    if harmonics:
        sh = np.empty(count, dtype=[(f"f_rest_{i}", "u1") for i in range(harmonics)])
        for name in sh.dtype.names or ():
            sh[name] = draw.integers(0, 256, count)
        found["sh"] = sh
    return found


def write(path: Path, parts: dict[str, np.ndarray]) -> Path:
    PlyData([PlyElement.describe(array, name) for name, array in parts.items()]).write(str(path))
    return path


def test_words_are_unpacked_by_hand_calculation(tmp_path: Path) -> None:
    parts = elements(2, 0)
    low, high = parts["chunk"]["min_x"][0], parts["chunk"]["max_x"][0]
    parts["vertex"]["packed_position"] = [(2047 << 21) | (0 << 11) | 1024, 0]
    # The largest component is the second, x; w = (0.5 - 0.5) sqrt 2, y = +1/sqrt 2, z = -1/sqrt 2.
    parts["vertex"]["packed_rotation"] = [(1 << 30) | (512 << 20) | (1023 << 10) | 0, 0]
    parts["vertex"]["packed_color"] = [(255 << 24) | (0 << 16) | (128 << 8) | 51, 255]
    read = read_compressed_ply(write(tmp_path / "a.ply", parts))
    assert read.means[0, 0].item() == pytest.approx(high, abs=1e-6)
    assert read.means[1, 0].item() == pytest.approx(low, abs=1e-6)
    z_low, z_high = parts["chunk"]["min_z"][0], parts["chunk"]["max_z"][0]
    assert read.means[0, 2].item() == pytest.approx(z_low + (z_high - z_low) * 1024 / 2047, abs=1e-6)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(read.quaternions[0].numpy(), [half / 1023, 0.0, half, -half], atol=1e-6)
    assert torch.sigmoid(read.opacity_logits).tolist() == pytest.approx([0.2, 254.5 / 255], abs=1e-6)
    red = parts["chunk"]["max_r"][0]
    assert read.sh[0, 0, 0].item() == pytest.approx((red - 0.5) / 0.28209479, rel=1e-5)


def test_every_chunk_has_its_own_range(tmp_path: Path) -> None:
    parts = elements(300, 0)
    parts["vertex"]["packed_position"] = 0
    read = read_compressed_ply(write(tmp_path / "a.ply", parts))
    expected = np.repeat(parts["chunk"]["min_y"], [256, 44])
    np.testing.assert_allclose(read.means[:, 1].numpy(), expected, atol=1e-6)


@pytest.mark.parametrize("harmonics", [0, 9, 24, 45])
def test_harmonics_are_channel_major_bytes_over_eight(tmp_path: Path, harmonics: int) -> None:
    parts = elements(5, harmonics)
    if harmonics:
        parts["sh"]["f_rest_0"] = [0, 1, 128, 254, 255]
    read = read_compressed_ply(write(tmp_path / "a.ply", parts))
    assert read.sh.shape == (5, 1 + harmonics // 3, 3)
    if harmonics:
        np.testing.assert_allclose(read.sh[:, 1, 0].numpy(), [-4.0, -3.953125, 0.015625, 3.953125, 4.0])
        stored = parts["sh"][f"f_rest_{harmonics // 3}"][2]
        assert read.sh[2, 1, 1].item() == pytest.approx((stored + 0.5) / 32 - 4, abs=0.016)


def test_older_files_without_colour_ranges_are_read(tmp_path: Path) -> None:
    parts = elements(5, 0)
    names = [name for name in parts["chunk"].dtype.names or () if name[-2:] not in ("_r", "_g", "_b")]
    parts["chunk"] = np.array(parts["chunk"][names].tolist(), dtype=[(name, "f4") for name in names])
    parts["vertex"]["packed_color"] = 255 << 24
    read = read_compressed_ply(write(tmp_path / "a.ply", parts))
    np.testing.assert_allclose(read.sh[0, 0].numpy() * 0.28209479 + 0.5, [1, 0, 0], atol=1e-6)


def test_rotations_have_unit_length(tmp_path: Path) -> None:
    read = read_compressed_ply(write(tmp_path / "a.ply", elements()))
    inside = read.quaternions.norm(dim=1) <= 1 + 1e-5  # random words may exceed the ball that real ones lie in
    assert inside.float().mean() > 0.4
    np.testing.assert_allclose(read.quaternions[inside].norm(dim=1).numpy(), 1, atol=1e-6)


def test_a_wrong_number_of_chunks_is_refused(tmp_path: Path) -> None:
    parts = elements(300)
    parts["chunk"] = parts["chunk"][:1]
    with pytest.raises(InputError, match="has 1 chunks where 300 Gaussians need 2"):
        read_compressed_ply(write(tmp_path / "a.ply", parts))


def test_harmonics_for_some_gaussians_only_are_refused(tmp_path: Path) -> None:
    parts = elements(300)
    parts["sh"] = parts["sh"][:299]
    with pytest.raises(InputError, match="harmonics for 299 of 300"):
        read_compressed_ply(write(tmp_path / "a.ply", parts))


def test_a_missing_property_is_named(tmp_path: Path) -> None:
    parts = elements(3)
    vertex = parts["vertex"]
    kept = [name for name in vertex.dtype.names or () if name != "packed_scale"]
    parts["vertex"] = np.array(vertex[kept].tolist(), dtype=[(name, "u4") for name in kept])
    with pytest.raises(InputError, match="has no packed_scale"):
        read_compressed_ply(write(tmp_path / "a.ply", parts))


def test_a_missing_element_is_named(tmp_path: Path) -> None:
    parts = elements(3, 0)
    del parts["chunk"]
    with pytest.raises(InputError, match="has no chunk element"):
        read_compressed_ply(write(tmp_path / "a.ply", parts))


def test_a_broken_range_is_refused_or_its_gaussians_dropped(tmp_path: Path) -> None:
    parts = elements(300)
    parts["chunk"]["max_z"][1] = np.nan
    path = write(tmp_path / "a.ply", parts)
    with pytest.raises(InputError, match="44 of 300 Gaussians"):
        read_compressed_ply(path)
    with pytest.warns(UserWarning, match="dropped"):
        assert len(read_compressed_ply(path, invalid="drop")) == 256


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.ply", elements())
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match=r"a\.ply: is no readable"):
        read_compressed_ply(path)
