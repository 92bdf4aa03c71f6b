import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import (
    VARIABLE,
    convert_read_errors,
    parse_json,
    read_bytes,
    read_configuration,
    read_yaml,
    reader,
    refuse_larger,
    refuse_larger_archive,
)
from gaussian_enhancer.scene.capture import open_capture
from gaussian_enhancer.scene.depth_files import depth_size
from gaussian_enhancer.scene.json_file import read_json
from gaussian_enhancer.scene.photos import list_images, read_header
from gaussian_enhancer.splat.io.open import read_splat


@contextmanager
def unprivileged() -> Iterator[None]:
    """Permissions mean nothing to the superuser."""
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(user)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "nested too deeply"),
        ('{"a":' * 100_000, "nested too deeply"),
        ('{"a": ' + "1" * 5000 + "}", "a number of 5000 digits"),
        ('{"a": ' + "1" * 400 + "}", "a number of 400 digits"),
        ('{"a": }', "line 1, column 7"),
    ],
)
def test_hostile_json_is_one_line(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as raised:
        parse_json(text, "a.json")
    assert str(raised.value).isprintable()


def test_a_byte_order_mark_is_no_content(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b'\xef\xbb\xbf{"a": 1}')
    assert read_json(tmp_path / "a.json") == {"a": 1}


@pytest.mark.parametrize("read", [read_bytes, read_splat, read_json])
def test_pipes_are_refused_before_they_are_waited_for(tmp_path: Path, read) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match=r"pipe: is no regular file"):
        read(tmp_path / "pipe")


def test_a_device_without_end_is_refused() -> None:
    with pytest.raises(InputError, match=r"/dev/zero: is no regular file"):
        read_bytes("/dev/zero")


@pytest.mark.parametrize(
    "read", [read_bytes, read_splat, read_json, read_header, open_capture, list_images, depth_size]
)
def test_missing_permission_is_named_as_such(tmp_path: Path, read) -> None:
    path = tmp_path / "a"
    if read in (open_capture, list_images):
        path.mkdir()
    else:
        path.write_bytes(b"content")
    path.chmod(0)
    with unprivileged(), pytest.raises(InputError, match=r"may not be read \(Permission denied\); give yourself"):
        read(path)


@pytest.mark.parametrize(("told", "allowed"), [("", 8e9), ("0.5", 0.5e9), ("100", 100e9)])
def test_the_limit_is_what_the_user_says(monkeypatch, told: str, allowed: float) -> None:
    monkeypatch.setenv(VARIABLE, told)
    refuse_larger("a", allowed, "is large")
    with pytest.raises(InputError, match=rf"a: is large, which takes up to .* GB.*{VARIABLE}"):
        refuse_larger("a", 1.01 * allowed, "is large")


@pytest.mark.parametrize("told", ["much", "0", "-1", "nan"])
def test_a_limit_that_is_no_number_is_refused(monkeypatch, told: str) -> None:
    monkeypatch.setenv(VARIABLE, told)
    with pytest.raises(InputError, match=f"{VARIABLE}: is '{told}'"):
        refuse_larger("a", 1, "is small")


def test_a_file_beyond_the_limit_is_not_read(tmp_path: Path, monkeypatch) -> None:
    with open(tmp_path / "a.json", "wb") as file:
        file.truncate(1 << 40)  # sparse: it takes no room
    with pytest.raises(InputError, match=r"a\.json: is \d+ bytes long, which takes up to"):
        read_json(tmp_path / "a.json")


def test_only_the_systems_and_codecs_errors_are_the_users() -> None:
    with pytest.raises(InputError, match="a: is truncated or damaged"), convert_read_errors("a"):
        raise EOFError("end")
    with pytest.raises(KeyError), convert_read_errors("a"):
        raise KeyError("our own mistake")

    @reader
    def read(path):
        return Path(path).read_text()

    with pytest.raises(InputError, match="nowhere: does not exist"):
        read("nowhere")
    with pytest.raises(InputError, match="File name too long"):
        read("a" * 300)


def test_yaml_that_grows_by_naming_its_parts_is_refused(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 12)]
    (tmp_path / "a.yaml").write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"a\.yaml: repeats a part of itself"):
        read_yaml(tmp_path / "a.yaml")


@pytest.mark.parametrize("text", ["[1, 2", "a: !!python/name:os.system", "[" * 5000, "a: \x00"])
def test_what_is_no_plain_yaml_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(InputError, match=r"a\.yaml: is no YAML"):
        read_yaml(tmp_path / "a.yaml")


def test_plain_yaml_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("a: [1, 2.5, null, x]\n")
    assert read_yaml(tmp_path / "a.yaml") == {"a": [1, 2.5, None, "x"]}


def test_a_configuration_is_a_mapping(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("3: {seed: 0}\n")
    assert read_configuration(tmp_path / "config.yaml") == {"3": {"seed": 0}}
    (tmp_path / "config.yaml").write_text("- 1\n")
    with pytest.raises(InputError, match=r"config\.yaml: is no configuration"):
        read_configuration(tmp_path / "config.yaml")


def test_an_archive_that_unpacks_to_more_than_the_limit_is_refused(tmp_path: Path, monkeypatch) -> None:
    with zipfile.ZipFile(tmp_path / "a.pt", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/data/0", bytes(10_000_000))
    refuse_larger_archive(tmp_path / "a.pt")
    monkeypatch.setenv(VARIABLE, "0.009")
    assert (tmp_path / "a.pt").stat().st_size < 100_000
    with pytest.raises(InputError, match=r"a\.pt: announces 10000000 bytes, which takes up to 0\.0 GB"):
        refuse_larger_archive(tmp_path / "a.pt")
