"""Unpacking: only what is asked for, never outside, whole or not at all."""

import stat
import zipfile

import pytest

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene import extract as module
from gaussian_enhancer.scene import transfer
from gaussian_enhancer.scene.extract import Parts, unpack
from support.archive_server import zipped
from support.failures import interrupt

FILES = {
    "garden/images/a.jpg": b"large" * 100,
    "garden/images_4/a.jpg": b"small",
    "garden/images_4/b.jpg": b"small too",
    "garden/sparse/0/cameras.bin": b"model",
    "garden/list.json": b"{}",
    "gardenia/images_4/c.jpg": b"another scene",
    "readme.txt": b"hello",
}
GARDEN = Parts("garden", ("sparse", "images_4", "list.json"))


@pytest.fixture
def archive(tmp_path):
    path = tmp_path / "archive.zip"
    path.write_bytes(zipped(FILES))
    return path


def files(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_only_the_parts_that_are_asked_for_come_out(tmp_path, archive):
    told = []
    assert unpack(archive, GARDEN, tmp_path / "out", lambda *state: told.append(state)) == GARDEN.names
    wanted = ["images_4/a.jpg", "images_4/b.jpg", "sparse/0/cameras.bin", "list.json"]
    assert files(tmp_path / "out") == {name: FILES[f"garden/{name}"] for name in wanted}
    assert told[-1] == (21, 21)


def test_what_is_there_is_left_alone_and_the_rest_is_added(tmp_path, archive):
    unpack(archive, GARDEN, tmp_path / "out")
    (tmp_path / "out/images_4/a.jpg").write_bytes(b"mine")
    assert unpack(archive, Parts("garden", ("images_4", "images")), tmp_path / "out") == ("images",)
    assert (tmp_path / "out/images_4/a.jpg").read_bytes() == b"mine"
    assert unpack(tmp_path / "gone.zip", GARDEN, tmp_path / "out") == ()


def test_files_that_are_no_photos_are_left_out(tmp_path, archive):
    unpack(archive, Parts("garden", ("images_4",), ("b.*",)), tmp_path / "out")
    assert sorted(files(tmp_path / "out")) == ["images_4/a.jpg"]


@pytest.mark.parametrize(
    "name", ["garden/images_4/../../../evil", "../evil", "/etc/evil", "garden\\..\\..\\evil", "C:/evil"]
)
def test_paths_outside_the_folder_are_refused(tmp_path, name):
    path = tmp_path / "a/b/archive.zip"
    path.parent.mkdir(parents=True)
    path.write_bytes(zipped({**FILES, name: b"evil"}))
    with pytest.raises(InputError, match="path is outside the target folder"):
        unpack(path, GARDEN, tmp_path / "a/b/out")
    assert [found.name for found in tmp_path.rglob("*") if found.is_file()] == ["archive.zip"]


def test_links_are_refused(tmp_path):
    path = tmp_path / "archive.zip"
    with zipfile.ZipFile(path, "w") as opened:
        for name, data in FILES.items():
            opened.writestr(name, data)
        link = zipfile.ZipInfo("garden/images_4/link")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        opened.writestr(link, "/etc/passwd")
    with pytest.raises(InputError, match="link"):
        unpack(path, GARDEN, tmp_path / "out")


def test_an_absent_part_is_named_with_what_there_is(tmp_path, archive):
    with pytest.raises(
        InputError, match=r"holds no garden/images_3 \(of garden: images, images_4, list.json, sparse\)"
    ):
        unpack(archive, Parts("garden", ("images_3",)), tmp_path / "out")


@pytest.mark.parametrize(
    "spoil", [lambda data: data[:200], lambda data: b"<html>", lambda data: data[:45] + b"#" * 60 + data[105:]]
)
def test_a_damaged_archive_leaves_no_part_behind(tmp_path, spoil):
    path = tmp_path / "archive.zip"
    path.write_bytes(spoil(zipped({"garden/images/a.jpg": bytes(range(256)) * 4, **FILES})))
    with pytest.raises(InputError, match="no intact zip file"):
        unpack(path, Parts("garden", ("images",)), tmp_path / "out")
    assert not (tmp_path / "out/images").exists()


def test_a_killed_unpacking_is_done_again(tmp_path, archive, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(module.os, "replace", interrupt)
        with pytest.raises(KeyboardInterrupt):
            unpack(archive, GARDEN, tmp_path / "out")
    assert not (tmp_path / "out/sparse").exists()
    unpack(archive, GARDEN, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["images_4", "list.json", "sparse"]


def test_a_full_disk_is_told_before(tmp_path, archive, monkeypatch):
    monkeypatch.setattr(transfer.shutil, "disk_usage", lambda folder: type("Usage", (), {"free": 20}))
    with pytest.raises(InputError, match=r"GB free where garden of archive\.zip needs"):
        unpack(archive, GARDEN, tmp_path / "out")
    assert files(tmp_path / "out") == {}
