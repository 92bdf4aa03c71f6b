"""Compressed .ply and .spz by gsply, read back by this project's own readers."""

from dataclasses import replace

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.io.open import read_splat
from gaussian_enhancer.splat.io.small_files import ENDINGS, write_compressed
from gaussian_enhancer.splat.methods import MipSplatting, ThreeDGS
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.types import Gaussians
from support.synthetic_runs import coloured_sheet, plane_camera

pytest.importorskip("gsply", reason="gsply is in the dependency group `test`")


def splat(degree: int) -> Gaussians:
    """A sheet whose Gaussians are turned, slender, of all opacities and coloured by direction."""
    sheet, generator = coloured_sheet(17), torch.Generator().manual_seed(2)
    count = len(sheet)
    higher = 0.15 * torch.randn(count, (degree + 1) ** 2 - 1, 3, generator=generator)
    return replace(
        sheet,
        means=sheet.means + 0.2 * torch.randn(count, 3, generator=generator),
        log_scales=sheet.log_scales + 0.4 * torch.randn(count, 3, generator=generator),
        quaternions=2 * torch.randn(count, 4, generator=generator),
        opacity_logits=2 * torch.randn(count, generator=generator),
        sh=torch.cat([sheet.sh, higher], 1),
    )


def likeness(first: torch.Tensor, second: torch.Tensor) -> float:
    return float(-10 * (first.clamp(0, 1) - second.clamp(0, 1)).square().mean().log10())


@pytest.mark.parametrize("degree", [0, 1, 3])
@pytest.mark.parametrize("name", list(ENDINGS))
def test_what_is_read_back_looks_the_same_from_every_side(tmp_path, name, degree):
    before = splat(degree)
    write_compressed(tmp_path / f"a{ENDINGS[name]}", before, name)
    after = read_splat(tmp_path / f"a{ENDINGS[name]}")
    assert after.sh.shape == before.sh.shape
    for index in (0, 3, 7):
        camera = plane_camera(index, 48, 64)
        images = [render(one, camera, ThreeDGS()).colour for one in (before, after)]
        assert likeness(*images) > 35
    assert [path.name for path in tmp_path.iterdir()] == [f"a{ENDINGS[name]}"]


@pytest.mark.parametrize("name", list(ENDINGS))
def test_the_filter_of_mip_splatting_is_applied(tmp_path, name):
    before = replace(splat(1), smoothing=torch.full((289,), 0.05))
    write_compressed(tmp_path / f"a{ENDINGS[name]}", before, name)
    after = read_splat(tmp_path / f"a{ENDINGS[name]}")
    assert after.smoothing is None
    camera = plane_camera(3, 48, 64)
    images = [
        render(one, camera, MipSplatting()).colour
        for one in (before, replace(after, smoothing=torch.zeros(len(after))), replace(before, smoothing=None))
    ]
    assert likeness(images[0], images[1]) > 35
    assert likeness(images[0], images[2]) < 30


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e4])
def test_positions_keep_their_digits_in_any_unit(tmp_path, unit):
    before = replace(splat(0), means=unit * splat(0).means)
    write_compressed(tmp_path / "a.spz", before, "spz")
    error = (read_splat(tmp_path / "a.spz").means - before.means).abs().max()
    assert float(error) < max(2e-6, 1e-6 * unit)


def test_disks_and_unknown_formats_are_refused(tmp_path):
    disks = replace(splat(0), log_scales=splat(0).log_scales[:, :2])
    with pytest.raises(InputError, match="holds no disks of 2DGS; use format=ply"):
        write_compressed(tmp_path / "a.spz", disks, "spz")
    with pytest.raises(InputError, match="format: is 'sog'; choose ply, compressed, spz"):
        write_compressed(tmp_path / "a.sog", splat(0), "sog")
    assert not list(tmp_path.iterdir())


def test_without_gsply_the_remedy_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "gsply", None)
    with pytest.raises(InputError, match=r"needs gsply.*gaussian-enhancer\[formats\]"):
        write_compressed(tmp_path / "a.spz", splat(0), "spz")
