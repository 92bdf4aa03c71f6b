import resource
from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.io.ply import read_ply, write_ply
from gaussian_enhancer.types import Gaussians


def splat(coefficients: int = 16, axes: int = 3, smoothing: bool = False, count: int = 7) -> Gaussians:
    draw = torch.Generator().manual_seed(coefficients + axes)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=draw)

    return Gaussians(
        means=normal(count, 3),
        log_scales=normal(count, axes),
        quaternions=normal(count, 4),
        opacity_logits=normal(count),
        sh=normal(count, coefficients, 3),
        smoothing=normal(count).abs() if smoothing else None,
    )


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
@pytest.mark.parametrize(("axes", "smoothing"), [(3, False), (2, False), (3, True)])
def test_what_is_written_is_read_back_bit_for_bit(
    tmp_path: Path, coefficients: int, axes: int, smoothing: bool
) -> None:
    written = splat(coefficients, axes, smoothing)
    write_ply(tmp_path / "deep" / "splat.ply", written)
    read = read_ply(tmp_path / "deep" / "splat.ply")
    for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh"):
        assert torch.equal(getattr(read, name), getattr(written, name)), name
    if written.smoothing is None:
        assert read.smoothing is None
    else:
        assert read.smoothing is not None
        assert torch.equal(read.smoothing, written.smoothing)


def test_the_layout_is_that_of_3dgs(tmp_path: Path) -> None:
    gaussians = splat(16)
    write_ply(tmp_path / "a.ply", gaussians)
    vertex = PlyData.read(str(tmp_path / "a.ply"))["vertex"]
    expected = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    expected += [f"f_rest_{i}" for i in range(45)]
    expected += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    assert [p.name for p in vertex.properties] == expected
    # 3DGS stores channel by channel: f_rest_15 is green's first higher coefficient.
    np.testing.assert_array_equal(vertex["f_rest_15"], gaussians.sh[:, 1, 1].numpy())
    np.testing.assert_array_equal(vertex["f_rest_44"], gaussians.sh[:, 15, 2].numpy())


def rewritten(path: Path, drop: tuple[str, ...] = (), text: bool = False, reverse: bool = False) -> None:
    """The file again with some properties left out, as text, or with the properties in the opposite order."""
    vertex = np.array(PlyData.read(str(path), mmap=False)["vertex"].data)
    names = [name for name in vertex.dtype.names or () if name not in drop]
    if reverse:
        names = names[::-1]
    fresh = np.empty(vertex.shape, dtype=[(name, "f8") for name in names])
    for name in names:
        fresh[name] = vertex[name]
    PlyData([PlyElement.describe(fresh, "vertex")], text=text).write(str(path))


def test_text_doubles_and_any_order_of_properties_are_read(tmp_path: Path) -> None:
    gaussians = splat(16)
    write_ply(tmp_path / "a.ply", gaussians)
    rewritten(tmp_path / "a.ply", text=True, reverse=True)
    read = read_ply(tmp_path / "a.ply")
    assert torch.equal(read.sh, gaussians.sh)
    assert torch.equal(read.quaternions, gaussians.quaternions)


def test_a_missing_property_is_named(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", splat())
    rewritten(tmp_path / "a.ply", drop=("opacity", "rot_2"))
    with pytest.raises(InputError, match=r"a\.ply: has no opacity, rot_2"):
        read_ply(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("drop", "found"), [(("f_rest_7",), "44 f_rest"), (("scale_0", "scale_1"), "scale_0, scale_1")]
)
def test_a_wrong_number_of_properties_is_refused(tmp_path: Path, drop: tuple[str, ...], found: str) -> None:
    write_ply(tmp_path / "a.ply", splat())
    rewritten(tmp_path / "a.ply", drop=drop)
    with pytest.raises(InputError, match=found):
        read_ply(tmp_path / "a.ply")


@pytest.mark.parametrize("keep", [0, 3, 40, 1500, -1])
def test_a_truncated_file_is_refused_by_name(tmp_path: Path, keep: int) -> None:
    write_ply(tmp_path / "a.ply", splat())
    whole = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(whole[:keep])
    with pytest.raises(InputError, match=r"a\.ply: is no readable \.ply of \d+ bytes"):
        read_ply(tmp_path / "a.ply")


@pytest.mark.parametrize("name", ["missing.ply", "."])
def test_what_is_not_there_is_refused_by_name(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"does not exist|is a folder"):
        read_ply(tmp_path / name)


def test_an_empty_splat_is_refused(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", splat(count=0))
    with pytest.raises(InputError, match="holds no Gaussians"):
        read_ply(tmp_path / "a.ply")


FIELDS = ("means", "log_scales", "quaternions", "opacity_logits", "sh", "smoothing")


@pytest.mark.parametrize(
    ("field", "value"),
    [(f, v) for f in FIELDS for v in (float("nan"), float("inf")) if (f, v) != ("opacity_logits", float("inf"))],
)
def test_gaussians_that_are_not_finite_are_refused_or_dropped(tmp_path: Path, field: str, value: float) -> None:
    gaussians = splat(smoothing=True)
    getattr(gaussians, field).view(len(gaussians), -1)[4, -1] = value
    write_ply(tmp_path / "a.ply", gaussians)
    with pytest.raises(InputError, match=r"a\.ply: 1 of 7 Gaussians are not finite.*first: 4.*drop"):
        read_ply(tmp_path / "a.ply")
    with pytest.warns(UserWarning, match=r"a\.ply: 1 of 7"):
        read = read_ply(tmp_path / "a.ply", invalid="drop")
    keep = torch.tensor([0, 1, 2, 3, 5, 6])
    assert torch.equal(read.means, gaussians.means[keep])
    assert torch.equal(read.sh, gaussians.sh[keep])


def test_opacities_of_exactly_0_and_1_are_read_as_the_bytes_of_compressed_formats(tmp_path: Path) -> None:
    gaussians = splat()
    gaussians.opacity_logits[:3] = torch.tensor([float("inf"), float("-inf"), 30.0])
    write_ply(tmp_path / "a.ply", gaussians)
    read = read_ply(tmp_path / "a.ply")
    assert read.opacity_logits[:2].sigmoid().tolist() == pytest.approx([254.5 / 255, 0.5 / 255], abs=1e-6)
    assert torch.equal(read.opacity_logits[2:], gaussians.opacity_logits[2:])


def test_a_rotation_of_no_length_is_refused(tmp_path: Path) -> None:
    gaussians = splat()
    gaussians.quaternions[2] = 0
    write_ply(tmp_path / "a.ply", gaussians)
    with pytest.raises(InputError, match="lack a rotation"):
        read_ply(tmp_path / "a.ply")


def test_dropping_every_gaussian_is_refused(tmp_path: Path) -> None:
    gaussians = splat()
    gaussians.means[:] = float("nan")
    write_ply(tmp_path / "a.ply", gaussians)
    with pytest.raises(InputError, match="7 of 7"):
        read_ply(tmp_path / "a.ply", invalid="drop")


@pytest.mark.parametrize("spare", [1, 3000])
def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path: Path, spare: int) -> None:
    """However little is missing: C's buffered writing, as numpy uses it, would cut the file without a word."""
    write_ply(tmp_path / "a.ply", splat(1))
    before = (tmp_path / "a.ply").read_bytes()
    write_ply(tmp_path / "b.ply", splat(16, count=60))
    need = (tmp_path / "b.ply").stat().st_size
    (tmp_path / "b.ply").unlink()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (need - spare, hard))
    try:
        with pytest.raises(InputError, match=r"a\.ply: cannot be written \(File too large\)"):
            write_ply(tmp_path / "a.ply", splat(16, count=60))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (tmp_path / "a.ply").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]


@pytest.mark.parametrize("count", [str(2**63), "9" * 400, "-1", "1e9", "99999999"])
def test_a_count_that_no_file_has_is_refused_from_the_header(tmp_path: Path, count: str) -> None:
    write_ply(tmp_path / "a.ply", splat())
    whole = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(whole.replace(b"element vertex 7", f"element vertex {count}".encode()))
    with pytest.raises(InputError, match=r"a\.ply: (announces|is no readable)"):
        read_ply(tmp_path / "a.ply")


def test_a_splat_beyond_the_limit_is_refused_from_the_header(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_ply(tmp_path / "a.ply", splat())
    monkeypatch.setenv("GAUSSIAN_ENHANCER_READ_LIMIT", "1e-6")
    with pytest.raises(InputError, match=r"a\.ply: announces 7 rows, which takes up to"):
        read_ply(tmp_path / "a.ply")


def test_lists_are_refused(tmp_path: Path) -> None:
    text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty list uchar int y\nend_header\n1 2 3 4\n"
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(InputError, match="has lists in its element vertex"):
        read_ply(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("field", "value"), [("sh", 1e20), ("log_scales", 90.0), ("log_scales", -1e30), ("means", 1e30)]
)
def test_values_that_overflow_are_refused(tmp_path: Path, field: str, value: float) -> None:
    gaussians = splat()
    getattr(gaussians, field)[4] = value
    write_ply(tmp_path / "a.ply", gaussians)
    with pytest.raises(InputError, match="1 of 7 Gaussians"):
        read_ply(tmp_path / "a.ply")
