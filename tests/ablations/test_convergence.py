"""The study of gain against the age of a splat."""

import json
import shutil
from pathlib import Path

import pytest
import torch

from ablations.scripts.convergence import (
    COLUMNS,
    KEYS,
    diagram_section,
    find_fits,
    harm,
    parse_method,
    picture_section,
    requested_methods,
    shown_views,
)
from ablations.study.roles import ROLES, role_of, with_roles
from ablations.study.row_table import page, read_layout
from ablations.study.rows import RowFile
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import load_weights, save_weights
from gaussian_enhancer.metrics.records import Record, write_records
from support.job_config import job_config
from support.networks import small_sif
from support.paths import DOCS


def test_a_method_names_weights_strength_and_what_is_left_out() -> None:
    methods = ["lr_tiny", "lr_tiny@0.5", "lr_tiny:without_confidence", "lr_tiny@1:plain"]
    made = {name: enhancer for name, _, enhancer in map(parse_method, methods)}
    own = load_weights("lr_tiny").strength
    assert list(made) == ["lr_tiny", "lr_tiny@0.5", f"lr_tiny@{own:g} without confidence", "lr_tiny@1 plain"]
    kept = [(one.strength, one.confidence is not None, one.colour_completion) for one in made.values()]
    assert kept == [(1.0, True, True), (0.5, True, True), (own, False, True), (1.0, False, False)]


@pytest.mark.parametrize(
    ("method", "said"),
    [
        ("lr_tiny@1:fast", "write :without_confidence or :plain"),
        ("lr_tiny@2", "from 0 to 1"),
        ("lr_tiny@x", "from 0 to 1"),
    ],
)
def test_another_ending_and_no_share_are_refused(method: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        parse_method(method)


def test_trainings_are_methods_of_their_own_and_none_is_measured_twice(tmp_path) -> None:
    files = [tmp_path / f"{label}-0123abcd" / "weights.safetensors" for label in ("narrow", "wide")]
    for file in files:
        file.parent.mkdir()
        save_weights(file, small_sif(), ReferenceConfig(), {})
    chosen = [f"methods=[{files[0]}@1,{files[1]}@1,average]", f"records={tmp_path}/found.jsonl"]
    made = requested_methods(job_config("convergence", *chosen))
    assert list(made) == ["narrow@1", "wide@1", "average of render and references"]
    for twice in (f"{files[0]}@1,{files[0]}@1.0", "average,average"):
        with pytest.raises(InputError, match=r"is the second method (narrow@1|average)"):
            requested_methods(job_config("convergence", f"methods=[{twice}]", chosen[1]))


def named_fit(plane_run: Path, folder: Path, scene: str) -> Path:
    """The plane's run as a fit of a scene that was given a name of its own (`output=`)."""
    shutil.copytree(plane_run, folder)
    write_records(folder / "records.jsonl", [Record("cost", folder.name, scene, "3dgs", "", "raw", {})])
    return folder


def test_the_page_is_made_again_from_the_records(plane_run, tmp_path, job, capsys) -> None:
    fit, records = named_fit(plane_run, tmp_path / "mine", "plush"), tmp_path / "found.jsonl"
    job("convergence", "methods=[lr_tiny,lr_tiny@1:plain]", f"runs=[{fit}]", f"records={records}")
    rows = [json.loads(line) for line in records.read_text().splitlines()]
    assert {row["scene"] for row in rows} == {"plush"}
    assert {row["step"] for row in rows} == {50, 100}
    first = capsys.readouterr().out
    assert len(first.splitlines()) == 2 + 2 * 2
    job("convergence", f"records={records}", f"page={tmp_path}/page.md")
    assert capsys.readouterr().out == first
    text = (tmp_path / "page.md").read_text()
    assert ".jpg" not in text
    assert "## Validation captures" in text
    assert "](page.svg)" in text
    assert (tmp_path / "page.svg").is_file()


def test_the_page_shows_the_worst_and_the_best_view_of_each_fit(plane_run, tmp_path, job) -> None:
    fit = named_fit(plane_run, tmp_path / "mine", "plush")
    files = (f"records={tmp_path}/found.jsonl", f"page={tmp_path}/page.md", f"pictures={tmp_path}/page")
    job("convergence", "methods=[lr_tiny,lr_tiny@1:plain]", f"runs=[{fit}]", *files)
    rows = [json.loads(line) for line in (tmp_path / "found.jsonl").read_text().splitlines()]
    gains = {
        Path(row["view"]).stem: row["gain_psnr_aligned"]
        for row in rows
        if (row["method"], row["step"]) == ("lr_tiny", 100)
    }
    made = (tmp_path / "page.md").read_text()
    for word, chosen in (("worst", min), ("best", max)):
        view = chosen(gains, key=gains.__getitem__)
        text = f"100 steps, view {view}: the {word} of {len(gains)}, {gains[view]:+.2f} dB"
        assert text in made.split(f"](page/plush_{word}.jpg)")[1]
        assert text in shown_views(tmp_path / "page.md")[f"page/plush_{word}.jpg"]


def test_fits_that_would_be_mixed_up_or_have_no_role_are_refused_before_they_are_measured(plane_run, tmp_path) -> None:
    folders = [named_fit(plane_run, tmp_path / f"{i}", scene) for i, scene in enumerate(("plush", "plush", "garden"))]
    with pytest.raises(InputError, match="is of the scene plush"):
        find_fits([str(folder) for folder in folders[:2]])
    with pytest.raises(InputError, match="has no role"):
        find_fits([str(folders[2])])
    with pytest.raises(InputError, match="name no fit"):
        find_fits([])


def test_fits_of_test_scenes_are_named_apart_and_have_a_section_of_their_own(plane_run, tmp_path, job, capsys) -> None:
    plush, fox = (named_fit(plane_run, tmp_path / f"mine_{scene}", scene) for scene in ("plush", "fox"))
    files = (f"records={tmp_path}/found.jsonl", f"page={tmp_path}/page.md")
    both = ("methods=[average]", "row_table=same_fits", "last=true", *files)
    with pytest.raises(SystemExit):
        job("convergence", f"runs=[{plush},{fox}]", *both)
    assert "is of the frozen test scene fox: nothing may be chosen by it" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"fox-3dgs-1a2b.*nothing may be chosen by it"):
        find_fits([str(fox.rename(tmp_path / "fox-3dgs-1a2b"))])
    with pytest.raises(InputError, match="is of plush, which is no test scene"):
        find_fits([], [str(plush)])
    assert not (tmp_path / "found.jsonl").exists()
    job("convergence", f"runs=[{plush}]", f"tests=[{tmp_path}/fox-3dgs-1a2b]", *both)
    text = (tmp_path / "page.md").read_text()
    views = len((tmp_path / "found.jsonl").read_text().splitlines()) // 2
    for role in ("Validation", "Test"):
        section = text.split(f"## {role} captures: all views")[1].split("## ")[0]
        assert f"| average of render and references | {views} |" in section


def test_records_of_something_else_are_refused(job, tmp_path, capsys) -> None:
    write_records(tmp_path / "other.jsonl", [Record("cost", "a", "plush", "3dgs", "", "raw", {})])
    with pytest.raises(SystemExit):
        job("convergence", f"records={tmp_path}/other.jsonl", f"page={tmp_path}/page.md")
    assert "lacks the column gain_psnr_aligned; measure again" in capsys.readouterr().err
    assert not (tmp_path / "page.md").exists()


def test_the_committed_page_is_what_its_records_say(tmp_path) -> None:
    committed = DOCS / "results/convergence.md"
    frame = with_roles(RowFile(DOCS / "results/convergence.jsonl", KEYS, COLUMNS).read())
    above, below = diagram_section(frame, tmp_path / "convergence.md"), picture_section(committed)
    assert page(frame, read_layout("convergence"), above, below) == committed.read_text()
    assert (tmp_path / "convergence.svg").read_bytes() == committed.with_suffix(".svg").read_bytes()


def test_every_role_has_a_title_and_an_unknown_capture_none() -> None:
    titles = read_layout("convergence").sections
    assert titles.keys() == ROLES.keys() == read_layout("distil_study").sections.keys()
    assert titles[role_of("plush")] == "Validation captures"
    assert titles[role_of("fox")] == "Test captures"
    with pytest.raises(InputError, match="has no role"):
        role_of("garden")


def test_harm_counts_the_blocks_that_lose() -> None:
    photo, render = torch.zeros(3, 32, 32), torch.full((3, 32, 32), 0.2)
    enhanced = render.clone()
    enhanced[:, :16, :16] = 0.4
    found = harm(render, enhanced, photo)
    assert found["blocks_harmed"] == 0.25
    assert found["error_removed"] == 0
    assert found["error_added"] == pytest.approx(0.75)
