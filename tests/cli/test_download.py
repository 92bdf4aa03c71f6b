"""The job ``download`` against a server on this machine: what is fetched, unpacked, listed, kept and refused."""

from pathlib import Path

import pytest
from omegaconf import DictConfig

from ablations.suite.inputs import missing_inputs
from gaussian_enhancer.cli import download
from gaussian_enhancer.errors import InputError
from support.archive_server import Served, serving, sha256, zipped
from support.job_config import job_config

SCENES = {
    f"{scene}/{part}": f"{scene} {part}".encode() * 30
    for scene in ("garden", "room")
    for part in ("images/a.jpg", "images_2/a.jpg", "images_4/a.jpg", "sparse/0/images.bin", "poses_bounds.npy")
}
OBJECTS = {
    f"nerf_synthetic/lego/{name}": name.encode()
    for name in (
        *(f"transforms_{side}.json" for side in ("train", "val", "test")),
        *("train/r_0.png", "val/r_0.png", "test/r_0.png", "test/r_0_depth_0001.png", "test/r_0_normal_0001.png"),
    )
}


def configured(folder: Path, served: Served, dataset: str, *overrides: str, checksum_known: bool = True) -> DictConfig:
    stated = [f"bytes={len(served.content)}", f"+sha256={sha256(served.content)}"] if checksum_known else ["bytes=null"]
    replaced = ["url=" + served.url, "+md5=null", *stated]
    words = [f"dataset={dataset}", f"folder={folder}", "retries=0", "runtime.progress=false", *overrides]
    words += ["++dataset.archives.base." + value.removeprefix("+") for value in replaced]
    return job_config("download", *words)


def tree(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_one_command_brings_the_photos_of_every_table(tmp_path):
    """Its official resolution, and for table 1 a quarter of the photos' size and the photos themselves."""
    with serving(zipped(SCENES)) as served:
        download.run(configured(tmp_path, served, "mip_nerf_360", "scenes=[garden,room]"))
    brought = {
        scene: {path.name for path in (tmp_path / "mip_nerf_360" / scene).iterdir()} for scene in ("garden", "room")
    }
    assert brought == {"garden": {"images", "images_4", "sparse"}, "room": {"images", "images_2", "images_4", "sparse"}}


def test_one_scene_at_its_official_resolution(tmp_path, capsys):
    with serving(zipped(SCENES)) as served:
        download.run(configured(tmp_path, served, "mip_nerf_360", "scenes=[garden]", "images=[images_4]"))
    archives = ["archives/360_v2.zip", "archives/360_v2.zip.sha256"]
    scene = ["mip_nerf_360/garden/images_4/a.jpg", "mip_nerf_360/garden/sparse/0/images.bin"]
    assert tree(tmp_path) == archives + scene
    assert (tmp_path / scene[0]).read_bytes() == SCENES["garden/images_4/a.jpg"]
    assert "licence: none is stated" in capsys.readouterr().out


def test_further_scenes_and_sizes_come_from_the_archive_that_is_there(tmp_path):
    with serving(zipped(SCENES)) as served:
        download.run(configured(tmp_path, served, "mip_nerf_360", "scenes=[garden]"))
        download.run(configured(tmp_path, served, "mip_nerf_360", "scenes=[garden,room]", "images=[images,images_4]"))
        download.run(configured(tmp_path, served, "mip_nerf_360", "scenes=[room]"))
        assert len(served.asked) == 1
    assert {path.name for path in (tmp_path / "mip_nerf_360/garden").iterdir()} == {"images", "images_4", "sparse"}
    room = {path.name for path in (tmp_path / "mip_nerf_360/room").iterdir()}
    assert room == {"images", "images_2", "images_4", "sparse"}


def test_archives_need_not_be_kept(tmp_path):
    with serving(zipped(SCENES)) as served:
        download.run(configured(tmp_path, served, "mip_nerf_360", "scenes=[garden]", "keep_archives=false"))
        download.run(configured(tmp_path, served, "mip_nerf_360", "scenes=[garden]"))
        assert len(served.asked) == 1  # what is unpacked is not fetched again
    assert tree(tmp_path / "archives") == ["360_v2.zip.sha256"]


def test_dry_run_lists_and_touches_nothing(tmp_path, capsys):
    folder = tmp_path / "not_there"
    with serving(zipped(SCENES)) as served:
        download.run(configured(folder, served, "mip_nerf_360", "dry_run=true", "scenes=[garden,flowers]"))
        assert served.asked == []
    assert not folder.exists()
    out = capsys.readouterr().out
    assert f"360_v2.zip: to fetch ({len(served.content)} bytes) from http://127.0.0.1" in out
    assert "360_extra_scenes.zip: to fetch (4.49 GB)" in out
    assert "no checksum published: the first copy's is kept beside it" in out
    assert "scene garden: to unpack: sparse, images_4" in out


def test_dry_run_says_what_is_there(tmp_path, capsys):
    with serving(zipped(SCENES)) as served:
        download.run(configured(tmp_path, served, "mip_nerf_360", "scenes=[garden]"))
        (tmp_path / "archives/360_v2.zip").rename(tmp_path / "archives/360_v2.zip.part")
        capsys.readouterr()
        download.run(configured(tmp_path, served, "mip_nerf_360", "scenes=[garden,room]", "dry_run=true"))
    out = capsys.readouterr().out
    assert f"{len(served.content)} bytes of it there" in out
    assert "scene garden: there: sparse, images_4, images\n" in out
    assert "scene room: to unpack: sparse, images_2, images_4, images" in out


def test_nerf_synthetic_comes_without_depth_and_normals(tmp_path):
    with serving(zipped(OBJECTS)) as served:
        download.run(configured(tmp_path, served, "nerf_synthetic", "scenes=[lego]"))
    files = tree(tmp_path / "nerf_synthetic/lego")
    assert files == sorted(name.removeprefix("nerf_synthetic/lego/") for name in OBJECTS if "_0001" not in name)


def test_archive_put_there_by_hand_is_checked_and_used(tmp_path):
    with serving(zipped(OBJECTS)) as served:
        cfg = configured(tmp_path, served, "nerf_synthetic", "scenes=[lego]")
        place = tmp_path / "archives/nerf_synthetic.zip"
        place.parent.mkdir()
        place.write_bytes(served.content[:-1] + b"!")
        with pytest.raises(InputError, match=r"is recorded; delete nerf_synthetic\.zip"):
            download.run(cfg)
        place.write_bytes(served.content)
        download.run(cfg)
        assert served.asked == []
    assert (tmp_path / "nerf_synthetic/lego/train/r_0.png").is_file()


def test_job_brings_what_the_scene_misses(tmp_path, monkeypatch):
    monkeypatch.setenv("GAUSSIAN_ENHANCER_DATASETS", str(tmp_path))
    scene = job_config("fit", "scene=datasets/garden").scene
    assert [path.name for path, _ in missing_inputs(scene)] == ["images_4", "0"]
    with serving(zipped(SCENES)) as served:
        download.run(configured(tmp_path, served, "mip_nerf_360", "scenes=[garden]"))
    assert missing_inputs(scene) == []


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["scenes=[gardn]"], r"scenes: names 'gardn'; choose from bicycle"),
        (["scenes=garden"], r"give a list: scenes=\[NAME,NAME\]"),
        (["scenes=[garden]", "images=[images_3]"], r"holds no garden/images_3 \(of garden: images, images_2"),
    ],
)
def test_mistakes_are_named(tmp_path, overrides, message):
    with serving(zipped(SCENES)) as served, pytest.raises(InputError, match=message):
        download.run(configured(tmp_path, served, "mip_nerf_360", *overrides))
