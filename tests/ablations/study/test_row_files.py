"""Files of rows of single views."""

import pytest

from ablations.study.row_files import RowFile
from gaussian_enhancer.errors import InputError


@pytest.fixture
def rows(tmp_path) -> RowFile:
    return RowFile(tmp_path / "rows.jsonl", ("scene", "splat", "psnr"), ("scene", "splat"), "runs")


def row(splat: str, psnr: float, scene: str = "plush") -> dict[str, object]:
    return {"scene": scene, "splat": splat, "psnr": psnr}


def test_rows_that_are_measured_again_replace_the_old_ones(rows):
    assert rows.held().empty
    rows.add([row("raw", 20.0), row("new", 21.0), row("new", 22.0)])
    rows.add([row("new", 23.0), row("raw", 30.0, "copr")])
    found = rows.read()
    assert found[["scene", "splat", "psnr"]].to_numpy().tolist() == [
        ["plush", "raw", 20.0],
        ["plush", "new", 23.0],
        ["copr", "raw", 30.0],
    ]
    assert found["commit"].notna().all()


@pytest.mark.parametrize(
    ("text", "said"), [("no rows", "is no file of rows"), ('{"scene": "a"}\n', "lacks the column")]
)
def test_a_file_of_something_else_is_refused_and_kept(rows, text, said):
    rows.path.write_text(text)
    for act in (rows.read, rows.held, lambda: rows.add([row("raw", 20.0)])):
        with pytest.raises(InputError, match=f"{said}.*with runs="):
            act()
    assert rows.path.read_text() == text
