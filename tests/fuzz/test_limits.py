"""Every reader of the campaign states what it will allocate before it reads, and the user's limit holds for it."""

from pathlib import Path

import pytest

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import VARIABLE

TESTS = Path(__file__).resolve().parents[1]


def test_no_reader_takes_more_than_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(TESTS / "splat/io")
    from fuzz.readers import READERS

    for name, reader in READERS.items():
        (tmp_path / name).mkdir()
        reader.make(tmp_path / name)
        monkeypatch.setenv(VARIABLE, "1e-8")
        with pytest.raises(InputError, match=f"limit is 1e-08 GB.*{VARIABLE}"):
            reader.read(tmp_path / name)
        monkeypatch.delenv(VARIABLE)
        assert reader.faults(reader.read(tmp_path / name)) == []
