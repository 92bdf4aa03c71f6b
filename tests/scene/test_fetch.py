"""Fetching from a server that cuts connections, ignores ranges, sends other files or none."""

import hashlib
import os
import socket
import subprocess
import sys

import numpy as np
import psutil
import pytest

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene import fetch as module
from gaussian_enhancer.scene import transfer
from gaussian_enhancer.scene.datasets import Archive
from gaussian_enhancer.scene.fetch import fetch
from support.archive_server import serving, sha256

CONTENT = np.random.default_rng(0).integers(0, 256, 300_000, dtype=np.uint8).tobytes()
QUICK = {"retries": 2, "pause": 0.001, "timeout": 60}


def archive(url: str, **values: object) -> Archive:
    return Archive("file.zip", url, **values)  # type: ignore[arg-type]


def leftovers(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_file_arrives_whole_with_its_checksum_beside_it(tmp_path):
    told = []
    with serving(CONTENT) as served:
        known = archive(served.url, bytes=len(CONTENT), sha256=sha256(CONTENT))
        digest = fetch(known, tmp_path / "a" / "file.zip", advance=lambda *state: told.append(state), **QUICK)
    assert (tmp_path / "a/file.zip").read_bytes() == CONTENT
    assert digest == sha256(CONTENT)
    assert leftovers(tmp_path / "a") == ["file.zip", "file.zip.sha256"]
    assert (tmp_path / "a/file.zip.sha256").read_text() == f"{digest}  file.zip\n"
    assert told[0] == (0, len(CONTENT))
    assert told[-1] == (len(CONTENT), len(CONTENT))


def test_cut_connections_are_resumed_from_where_they_broke(tmp_path):
    with serving(CONTENT, cut_after=[100_000, 50_000, 1]) as served:
        fetch(archive(served.url, sha256=sha256(CONTENT)), tmp_path / "file.zip", **QUICK)
        assert served.asked == [None, "bytes=100000-", "bytes=150000-", "bytes=150001-"]
    assert (tmp_path / "file.zip").read_bytes() == CONTENT


def test_a_later_run_goes_on_where_an_earlier_one_gave_up(tmp_path):
    with serving(CONTENT, cut_after=[70_000, 0, 0, 0]) as served:
        known = archive(served.url, bytes=len(CONTENT))
        with pytest.raises(InputError, match=r"broke off 3 times in a row, 70000 bytes.*run the same command later"):
            fetch(known, tmp_path / "file.zip", **QUICK)
        assert not (tmp_path / "file.zip").exists()
        fetch(known, tmp_path / "file.zip", **QUICK)
        assert served.asked[-1] == "bytes=70000-"
    assert (tmp_path / "file.zip").read_bytes() == CONTENT


def test_a_file_that_changed_meanwhile_starts_anew(tmp_path):
    other = CONTENT[::-1]
    with serving(CONTENT, cut_after=[70_000, 0, 0, 0]) as served:
        with pytest.raises(InputError):
            fetch(archive(served.url), tmp_path / "file.zip", **QUICK)
        served.content, served.tag = other, '"two"'
        fetch(archive(served.url), tmp_path / "file.zip", **QUICK)
    assert (tmp_path / "file.zip").read_bytes() == other


def test_a_server_that_ignores_ranges_sends_everything_again(tmp_path):
    with serving(CONTENT, ranges=False, cut_after=[100_000, 200_000]) as served:
        fetch(archive(served.url, sha256=sha256(CONTENT)), tmp_path / "file.zip", **QUICK)
        assert len(served.asked) == 3
    assert (tmp_path / "file.zip").read_bytes() == CONTENT


def test_a_server_that_never_gets_further_is_given_up(tmp_path):
    with serving(CONTENT, ranges=False, cut_after=[2000] + [1000, 1500] * 10) as served:
        with pytest.raises(InputError, match="broke off 3 times"):
            fetch(archive(served.url), tmp_path / "file.zip", **QUICK)
        assert len(served.asked) == 4


def test_a_part_that_is_complete_already_is_taken(tmp_path):
    (tmp_path / "file.zip.part").write_bytes(CONTENT)
    with serving(CONTENT) as served:
        fetch(archive(served.url, sha256=sha256(CONTENT)), tmp_path / "file.zip", **QUICK)
        assert served.asked == [f"bytes={len(CONTENT)}-"]
    assert leftovers(tmp_path) == ["file.zip", "file.zip.sha256"]


def test_a_part_longer_than_the_file_starts_anew(tmp_path):
    (tmp_path / "file.zip.part").write_bytes(CONTENT + b"more")
    with serving(CONTENT) as served:
        fetch(archive(served.url, bytes=len(CONTENT)), tmp_path / "file.zip", **QUICK)
    assert (tmp_path / "file.zip").read_bytes() == CONTENT


@pytest.mark.parametrize("kind", ["sha256", "md5"])
def test_a_wrong_file_is_refused_and_removed(tmp_path, kind):
    wrong = hashlib.new(kind, b"another file").hexdigest()
    with serving(CONTENT) as served, pytest.raises(InputError, match=rf"{wrong} is recorded"):
        fetch(archive(served.url, **{kind: wrong}), tmp_path / "file.zip", **QUICK)
    assert leftovers(tmp_path) == []


def test_a_file_of_another_size_is_refused_before_it_is_fetched(tmp_path):
    with serving(CONTENT) as served:
        with pytest.raises(InputError, match=r"300000 bytes where 7 are recorded.*https://authors"):
            fetch(archive(served.url, bytes=7), tmp_path / "file.zip", page="https://authors", **QUICK)
        assert len(served.asked) == 1
    assert (tmp_path / "file.zip.part").stat().st_size == 0


def test_without_a_published_checksum_the_first_copy_is_the_measure(tmp_path):
    path = tmp_path / "file.zip"
    with serving(CONTENT) as served:
        fetch(archive(served.url), path, **QUICK)
        path.unlink()
        served.content = b"something else"
        with pytest.raises(
            InputError, match=rf"{sha256(b'something else')} where {sha256(CONTENT)} is in file.zip.sha256"
        ):
            fetch(archive(served.url), path, **QUICK)
    assert leftovers(tmp_path) == ["file.zip.sha256"]


def test_the_servers_own_checksum_is_compared(tmp_path):
    with serving(CONTENT, md5=hashlib.md5(b"x").digest()) as served:
        with pytest.raises(InputError, match="stated by the server"):
            fetch(archive(served.url), tmp_path / "file.zip", **QUICK)
        served.md5 = hashlib.md5(CONTENT).digest()
        fetch(archive(served.url), tmp_path / "file.zip", **QUICK)
    assert (tmp_path / "file.zip").read_bytes() == CONTENT


def test_passing_errors_are_waited_out(tmp_path):
    with serving(CONTENT, fail_first=2) as served:
        fetch(archive(served.url), tmp_path / "file.zip", **QUICK)
        assert len(served.asked) == 3


@pytest.mark.parametrize("status", [403, 404, 410])
def test_a_moved_file_is_named_at_once_with_what_to_do(tmp_path, status):
    with serving(CONTENT, status=status) as served:
        with pytest.raises(InputError, match=rf"answers {status} .*dataset\.archives.*by hand"):
            fetch(archive(served.url), tmp_path / "file.zip", **QUICK)
        assert len(served.asked) == 1


def test_a_web_page_is_no_archive(tmp_path):
    page = serving(b"<html>log in</html>", kind="text/html; charset=utf-8")
    with page as served, pytest.raises(InputError, match="a web page instead of the archive"):
        fetch(archive(served.url), tmp_path / "file.zip", **QUICK)


def test_nobody_answers(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}/file.zip"
    with pytest.raises(InputError, match="broke off 3 times in a row, 0 bytes"):
        fetch(archive(url), tmp_path / "file.zip", **QUICK)


def test_a_full_disk_is_told_before_anything_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(transfer.shutil, "disk_usage", lambda folder: type("Usage", (), {"free": 1000}))
    with serving(CONTENT) as served, pytest.raises(InputError, match=r"0\.00 GB free where file\.zip needs"):
        fetch(archive(served.url), tmp_path / "file.zip", **QUICK)
    assert (tmp_path / "file.zip.part").stat().st_size == 0


def test_two_processes_do_not_write_the_same_file(tmp_path):
    with module._lock_part(tmp_path / "file.zip.part"), serving(CONTENT) as served:
        with pytest.raises(InputError, match="by another process"):
            fetch(archive(served.url), tmp_path / "file.zip", **QUICK)
        assert served.asked == []


def test_the_part_is_closed_before_it_is_moved_or_removed(tmp_path, monkeypatch):
    """Windows refuses both for an open file."""

    def closed(function):
        def checked(path, *arguments, **options):
            assert str(path) not in [file.path for file in psutil.Process().open_files()]
            return function(path, *arguments, **options)

        return checked

    monkeypatch.setattr(module.os, "replace", closed(os.replace))
    monkeypatch.setattr(module.Path, "unlink", closed(module.Path.unlink))
    with serving(CONTENT) as served:
        fetch(archive(served.url), tmp_path / "file.zip", **QUICK)
        with pytest.raises(InputError, match="is recorded"):
            fetch(archive(served.url, sha256=sha256(b"another")), tmp_path / "other.zip", **QUICK)
    assert leftovers(tmp_path) == ["file.zip", "file.zip.sha256"]


def test_it_is_imported_where_there_is_no_fcntl():
    """As on Windows."""
    program = "import sys; sys.modules['fcntl'] = None; import gaussian_enhancer.scene.fetch"
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
