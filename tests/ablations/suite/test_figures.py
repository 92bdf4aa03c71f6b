"""A grid of images with one line a type of artefact."""

from pathlib import Path

import pytest
import torch
from hydra import compose

from ablations.report.grids import PHOTO
from ablations.suite.descriptions import read_experiment
from ablations.suite.figures import figure_rows
from gaussian_enhancer.scene.image_files import write_image
from support.job_config import initialised


@pytest.fixture(scope="module")
def figure():
    with initialised():
        return read_experiment("figure_7", compose("tables", ["table=7", "scale=smoke"]).scale)


def test_figure_7_goes_through_artefacts(figure) -> None:
    assert figure.table.artefacts == ("needle", "banding", "floater", "blur")


def test_each_line_shows_the_view_and_place_of_its_artefact(figure, tmp_path: Path) -> None:
    """The enhanced image has no say: only renders and photos are given."""
    photo = 0.5 + 0.05 * torch.rand(3, 96, 128, generator=torch.Generator().manual_seed(0))
    there: dict[str, dict[str, Path]] = {"raw": {}, PHOTO: {}}
    for view in ("a.png", "b.png"):
        render = photo.clone()
        if view == "b.png":
            for offset in range(0, 24, 6):
                render[:, 68 + offset, 90:125] = 0.95
        for method, image in (("raw", render), (PHOTO, photo)):
            there[method][view] = tmp_path / f"{method}-{view}"
            write_image(there[method][view], image)
    lines = list(figure_rows(figure, "outdoor, 3dgs", there, ["a.png", "b.png"]))
    assert [label for label, _, _ in lines] == [f"outdoor, 3dgs: {name}" for name in figure.table.artefacts]
    _, view, box = lines[0]
    assert view == "b.png"
    assert box is not None
    left, top, right, bottom = box
    assert left > 0.4
    assert top > 0.4
    assert right - left == pytest.approx(1 / 3, abs=0.02)
    assert bottom <= 1


def test_without_photos_the_first_view_isfigure_rows(figure) -> None:
    assert list(figure_rows(figure, "outdoor, 3dgs", {"raw": {"b.png": Path("b")}}, ["b.png"])) == [
        ("outdoor, 3dgs", "b.png", None)
    ]
