import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.io.open import read_splat
from gaussian_enhancer.splat.io.ply import write_ply
from gaussian_enhancer.types import Gaussians


def splat(count: int = 3) -> Gaussians:
    ones = torch.ones(count, 3)
    return Gaussians(ones, -ones, torch.ones(count, 4), torch.zeros(count), torch.zeros(count, 16, 3))


def test_the_content_decides_and_not_the_ending(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.spz", splat())
    assert len(read_splat(tmp_path / "a.spz")) == 3


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n", b"PK\x03\x04", b"hello, this is text"])
def test_other_content_is_refused_with_the_formats_that_are_read(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.ply: is .*; give a (3DGS )?\.ply"):
        read_splat(tmp_path / "a.ply")


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        read_splat(tmp_path / "none.ply")
    with pytest.raises(InputError, match="is a folder"):
        read_splat(tmp_path)


def test_bad_gaussians_are_dropped_only_when_asked(tmp_path: Path) -> None:
    bad = splat()
    bad.means[1] = float("nan")
    write_ply(tmp_path / "a.ply", bad)
    with pytest.raises(InputError, match="1 of 3"):
        read_splat(tmp_path / "a.ply")
    with pytest.warns(UserWarning, match="dropped"):
        assert len(read_splat(tmp_path / "a.ply", invalid="drop")) == 2


@pytest.fixture
def splats() -> Path:
    folder = os.environ.get("GAUSSIAN_ENHANCER_DATA")
    if not folder or not (Path(folder) / "splats" / "biker.spz").exists():
        pytest.skip("GAUSSIAN_ENHANCER_DATA names no folder with splats/biker.spz")
    return Path(folder) / "splats"


@pytest.mark.captures
def test_one_splat_in_two_formats_is_the_same_splat(splats: Path) -> None:
    """The biker as SuperSplat's .ply and as .spz: the same Gaussians in the same order, up to quantisation."""
    ply, spz = read_splat(splats / "biker.compressed.ply"), read_splat(splats / "biker.spz")
    assert len(ply) == len(spz) == 152_746
    assert (ply.means - spz.means).abs().max() < 2**-12
    assert (ply.log_scales.clamp(min=-10) - spz.log_scales).abs().max() < 1 / 32 + 1e-5
    assert (ply.sh - spz.sh).abs().max() < 0.5 / 255 / 0.15 + 1e-3
    assert (ply.opacity_logits - spz.opacity_logits).abs().max() < 1e-5
    unit = [torch.nn.functional.normalize(g.quaternions, dim=1) for g in (ply, spz)]
    angle = 2 * torch.acos((unit[0] * unit[1]).sum(1).abs().clamp(max=1))
    assert angle.max() < np.radians(0.2)


@pytest.mark.captures
@pytest.mark.parametrize(("name", "count"), [("biker", 152_746), ("guitar", 90_854)])
def test_splats_found_in_the_wild_have_plausible_extents(splats: Path, name: str, count: int) -> None:
    read = read_splat(splats / f"{name}.compressed.ply")
    assert len(read) == count
    extent = read.means.amax(0) - read.means.amin(0)
    assert (extent > 0.5).all()
    assert (extent < 6).all()
    assert extent.argmax() == 1  # the biker and the guitar stand upright
    assert read.log_scales.exp().median() < 0.02 * extent.max()
    base = (read.sh[:, 0] * 0.28209479 + 0.5).clamp(0, 1)
    assert 0.1 < base.mean() < 0.9
    torch.testing.assert_close(read.quaternions.norm(dim=1), torch.ones(count), atol=1e-4, rtol=0)


@pytest.mark.captures
def test_a_copy_cut_short_is_refused(splats: Path, tmp_path: Path) -> None:
    for name in ("biker.compressed.ply", "biker.spz"):
        cut = Path(shutil.copyfile(splats / name, tmp_path / name))
        with open(cut, "r+b") as file:
            file.truncate(cut.stat().st_size // 2)
        with pytest.raises(InputError, match=name):
            read_splat(cut)
