"""The latest splat of a result folder of 3DGS or gsplat."""

from pathlib import Path

import pytest

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.io.open import read_splat
from gaussian_enhancer.splat.io.result_folders import find_splat
from support.foreign_splats import bare, same, splat, write, write_checkpoint


def test_the_latest_step_is_taken_and_its_ply_before_its_checkpoint(tmp_path: Path) -> None:
    for step in (6999, 29999):
        write_checkpoint(tmp_path / f"ckpts/ckpt_{step}_rank0.pt", splat(1))
    (tmp_path / "ply").mkdir()
    write(tmp_path / "ply/point_cloud_6999.ply", splat(2), bare(2))
    assert find_splat(tmp_path).name == "ckpt_29999_rank0.pt"
    write(tmp_path / "ply/point_cloud_29999.ply", splat(3), bare(3))
    assert find_splat(tmp_path).name == "point_cloud_29999.ply"
    assert same(read_splat(tmp_path), splat(3))


def test_the_latest_iteration_of_3dgs_is_taken(tmp_path: Path) -> None:
    for step in (7000, 30000, 900):
        file = tmp_path / f"point_cloud/iteration_{step}/point_cloud.ply"
        file.parent.mkdir(parents=True)
        degree = int(step == 30000)
        write(file, splat(degree), bare(degree))
    (tmp_path / "point_cloud/iteration_last").mkdir()
    (tmp_path / "point_cloud/iteration_last/point_cloud.ply").write_bytes(b"")
    assert find_splat(tmp_path).parent.name == "iteration_30000"
    assert same(read_splat(tmp_path), splat(1))


def test_a_folder_without_a_splat_is_refused(tmp_path: Path) -> None:
    (tmp_path / "ckpts").mkdir()
    (tmp_path / "ckpts/other.pt").write_bytes(b"")
    with pytest.raises(
        InputError, match=r"is a folder without point_cloud/iteration_STEP.*, ply/point_cloud_STEP\.ply and ckpts/"
    ):
        read_splat(tmp_path)
