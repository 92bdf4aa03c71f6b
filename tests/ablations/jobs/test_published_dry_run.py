"""A dry run over small folders in the published layout of all four data sets: ready, missing, incomplete, unset."""

from pathlib import Path

import pytest
from PIL import Image

from ablations.suite.dry_run import format_plan
from support.captures_on_disk import COUNT, HEIGHT, WIDTH, colmap_to_binary, write_colmap
from support.published_on_disk import write_pyramid, write_synthetic
from support.tiny_suite import plan, started

SCENES = {
    "mip_nerf_360": ("object", "garden"),
    "tanks_temples": ("other", "train"),
    "deep_blending": ("third", "playroom"),
    "nerf_synthetic": ("fourth", "lego"),
}
"""The tiny scale's stand-in of each data set, and the published scene in its place."""
TITLES = ("Mip-NeRF 360", "Tanks & Temples", "Deep Blending", "NeRF-Synthetic")
TABLES = "table=[1,2,4,5,6]"
"""Each data set, and table 1, which needs photos of four times the resolution."""


def words(photos: int | None = COUNT) -> list[str]:
    """Overrides by which the tiny scale measures on published scenes of so many photos; None: as published."""
    scenes = [
        f"scale.datasets.{dataset}.scenes.{stand_in}=['scene=datasets/{name}'"
        + (f",'scene.photos={photos}']" if photos else "]")
        for dataset, (stand_in, name) in SCENES.items()
    ]
    return [TABLES, *scenes, "scale.fit=[]", "scale.sparse=[]", "scale.finer.fit=['scene.downscale=4']"]


@pytest.fixture
def published(tmp_path, monkeypatch) -> Path:
    """A folder with a scene of each data set, as the job ``download`` leaves it."""
    root = tmp_path / "sets"
    write_pyramid(root / "mip_nerf_360/garden")
    for scene in ("tanks_temples/train", "deep_blending/playroom"):
        write_colmap(root / scene)
        colmap_to_binary(root / scene / "sparse/0")
    for path in (root / "tanks_temples/train/images").iterdir():
        Image.open(path).resize((WIDTH // 2, HEIGHT // 2), Image.Resampling.BOX).save(path)
    write_synthetic(root / "nerf_synthetic/lego")
    monkeypatch.setenv("GAUSSIAN_ENHANCER_DATASETS", str(root))
    monkeypatch.chdir(tmp_path)
    return root


def cells(text: str) -> dict[str, list[str]]:
    """What the lines of cells say, by data set."""
    lines = [line.removeprefix("cell   ").split(": ", 1) for line in text.splitlines() if line.startswith("cell ")]
    return {title: [said for name, said in lines if f", {title}," in name] for title in TITLES}


def test_every_cell_of_all_four_data_sets_is_ready_with_a_forecast(published, capsys) -> None:
    started(*words(), "dry_run=true")
    text = capsys.readouterr().out
    assert text.endswith("nothing is missing\n")
    assert "MISSING" not in text
    assert "not started" not in text
    for said in cells(text).values():
        assert said
        assert all(line.startswith("ready; ") and " runs to make; about " in line for line in said)


def test_a_row_names_what_its_fit_lacks_and_other_data_sets_stay_ready(published) -> None:
    (published / "deep_blending/playroom/images").rename(published / "elsewhere")
    steps = plan(*words())
    (fit,) = [step for step in steps if step.work.job == "fit" and step.missing and step.work.fit[-1] == "splat=3dgs"]
    text = format_plan(steps)
    row = next(line for line in text.splitlines() if line.startswith("row    third-3dgs-raw"))
    assert "playroom/images does not exist; fetch it: gaussian-enhancer download dataset=deep_blending" in row
    assert f"needed by {fit.name}" in row
    for title, said in cells(text).items():
        assert all(line.startswith("MISSING: " if title == "Deep Blending" else "ready; ") for line in said), title


def test_photos_of_four_times_the_resolution_are_asked_for_where_a_table_needs_them(published) -> None:
    (published / "mip_nerf_360/garden/images").rename(published / "elsewhere")
    text = format_plan(plan(*words()))
    lines = [line for line in text.splitlines() if line.startswith("cell   ") and "Mip-NeRF 360" in line]
    assert {(line.split(",")[0], "garden/images does not exist" in line) for line in lines} == {
        ("cell   table_1", True),
        ("cell   table_2", False),
    }


def test_fewer_photos_than_published_are_refused_as_the_fit_refuses_them(published) -> None:
    text = format_plan(plan(*words(photos=None)))
    for title, count in zip(TITLES, (185, 301, 225, 400), strict=True):
        assert all(f"holds 9 photos where the published scene has {count}" in line for line in cells(text)[title])


def test_the_unset_variable_is_named_plainly_and_the_forecast_stays(published, monkeypatch, capsys) -> None:
    started(*words(), "dry_run=true")
    known = capsys.readouterr().out
    monkeypatch.delenv("GAUSSIAN_ENHANCER_DATASETS")
    started(*words(), "dry_run=true")
    text = capsys.readouterr().out
    assert "KeyError" not in text
    for dataset, said in zip(SCENES, cells(text).values(), strict=True):
        remedy = "set GAUSSIAN_ENHANCER_DATASETS to the folder of the data sets (gaussian-enhancer download dataset="
        assert all(line.startswith(f"MISSING: {remedy}{dataset}), needed by ") for line in said)

    def totals(found: str) -> list[str]:
        return [line for line in found.splitlines() if "minutes to go" in line or line.startswith("predicted")]

    assert totals(text) == totals(known)
    assert text.splitlines()[-4].split(" runs: ")[0] == known.splitlines()[-4].split(" runs: ")[0]


def test_a_missing_backbone_leaves_its_cells_ready(published, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.delenv("GAUSSIAN_ENHANCER_DATA", raising=False)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    started(*words(), "dry_run=true", "scale.lpips=[lpips_vgg_raw]")
    text = capsys.readouterr().out
    assert "ready; without lpips_vgg_raw: no backbone; " in text
    assert text.endswith("nothing is missing\n")


def test_rows_reckon_with_the_published_number_of_views(published) -> None:
    raw = [step for step in plan(*words(), "scale.every=1") if step.work.method == "raw"]
    minutes = {step.name.split("-")[0]: step.minutes for step in raw if not (step.work.cell and step.work.cell.finer)}
    assert minutes["fourth"] == pytest.approx(200 * 0.01)  # NeRF-Synthetic's own split
    assert minutes["other"] == pytest.approx(2 * 0.01)  # every 8th of 9 photos
