"""The study of distilling: means over views, gains over the raw render, rows that are measured again."""

import json
import shutil
from pathlib import Path

import pandas as pd
import pytest

from ablations.scripts.distil_study import COLUMNS, KEYS, choose_runs, gains_over_render, parse_run
from ablations.study.row_table import page, read_layout, row_table
from ablations.study.rows import RowFile
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import Record, write_records
from support.paths import DOCS


def frame(splat: str, *psnr: float, image: str = "render", scene: str = "plush") -> pd.DataFrame:
    rows = [
        {
            "role": "validation",
            "scene": scene,
            "splat": splat,
            "seconds": 10.0,
            "gaussians": 5.0,
            "view": f"{number}.png",
            "image": image,
            "psnr": value - 1,
            "psnr_aligned": value,
            "ssim": 0.9,
        }
        for number, value in enumerate(psnr)
    ]
    return pd.DataFrame(rows)


def test_gains_are_over_the_raw_render_of_the_same_capture():
    other = frame("raw", 10.0, scene="copr")
    found = pd.concat([frame("raw", 20.0, 30.0), frame("raw", 22.0, 30.0, image="lr"), other, frame("new", 19.0, 34.0)])
    rows, layout = gains_over_render(found.reset_index(drop=True)), read_layout("distil_study")
    table = row_table(rows, layout).set_index(["scene", "splat", "image"])
    gain = ["gain, aligned", "worst view"]
    assert table.loc[("plush", "raw", "render"), ["PSNR, aligned", *gain]].tolist() == ["25.00", "+0.00", "+0.00"]
    assert table.loc[("plush", "raw", "lr"), gain].tolist() == ["+1.00", "+0.00"]
    assert table.loc[("plush", "new", "render"), [*gain, "views"]].tolist() == ["+1.50", "-1.00", "2"]
    assert table.loc[("copr", "raw", "render"), "gain, aligned"] == "+0.00"
    text = page(rows, layout)
    assert "## Validation captures" in text
    assert "| 26.50 |" in text
    assert "| +1.50 |" in text


@pytest.fixture
def fitted(plane_run, tmp_path) -> Path:
    """The plane's run with a record of what it cost."""
    folder = tmp_path / "fit:a"
    shutil.copytree(plane_run, folder)
    cost = {"milliseconds": 1500.0, "gaussians": 7.0}
    write_records(folder / "records.jsonl", [Record("cost", "a", "plush", "3dgs", "", "raw", cost)])
    return folder


def test_a_run_is_named_by_capture_and_splat(fitted):
    one = parse_run(f"plush/weight and share 0.3:{fitted}")
    assert (one.capture, one.splat, one.run) == ("plush", "weight and share 0.3", fitted)
    assert (one.seconds, one.gaussians) == (1.5, 7)
    for bad in ("plush:a", "plush/raw", "/raw:a"):
        with pytest.raises(InputError, match="write CAPTURE/SPLAT:RUN"):
            parse_run(bad)
    with pytest.raises(InputError, match="has no role"):
        parse_run(f"garden/raw:{fitted}")
    write_records(fitted / "records.jsonl", [Record("quality", "a", "plush", "3dgs", "", "raw", {})])
    with pytest.raises(InputError, match="holds no record of cost"):
        parse_run(f"plush/raw:{fitted}")


def test_runs_that_cannot_be_compared_are_refused_before_they_are_measured(fitted):
    words = [f"plush/raw:{fitted}", f"plush/new:{fitted}"]
    assert [one.splat for one in choose_runs(words, ())] == ["raw", "new"]
    assert [one.splat for one in choose_runs(words[1:], {("plush", "raw")})] == ["new"]
    with pytest.raises(InputError, match="add plush/raw:FIT to runs"):
        choose_runs(words[1:], {("copr", "raw"), ("plush", "other")})
    with pytest.raises(InputError, match="name plush/new twice"):
        choose_runs([*words, words[1]], ())


def test_the_page_is_made_again_from_the_records(fitted, tmp_path, job, capsys):
    records, text = tmp_path / "found.jsonl", tmp_path / "page.md"
    job("distil_study", f"runs=['plush/raw:{fitted}','plush/new, too:{fitted}']", f"records={records}", f"page={text}")
    rows = [json.loads(line) for line in records.read_text().splitlines()]
    assert {(row["splat"], row["image"]) for row in rows} == {
        (splat, image) for splat in ("raw", "new, too") for image in {row["image"] for row in rows}
    }
    assert len({row["image"] for row in rows}) == 2
    assert {"commit", "machine", "weights"} <= set(rows[0])
    first, printed = text.read_text(), capsys.readouterr().out
    assert "| plush | new, too | render |" in first
    job("distil_study", f"records={records}", f"page={text}")
    assert text.read_text() == first
    assert capsys.readouterr().out == printed


def test_the_committed_page_is_what_its_records_say():
    rows = RowFile(DOCS / "results/distil.jsonl", KEYS, COLUMNS).read()
    assert page(gains_over_render(rows), read_layout("distil_study")) == (DOCS / "results/distil.md").read_text()
