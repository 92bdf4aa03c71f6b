from pathlib import Path

import pytest
from PIL import Image, ImageChops, ImageDraw

from ablations.report.grids import PHOTO, crop_box, write_grid
from ablations.study.description import MethodDescription, SceneGroup, TableDescription
from gaussian_enhancer.errors import InputError

TABLE = TableDescription(
    "figure_7",
    "Artefacts",
    "images",
    "",
    {"raw": MethodDescription("3DGS", role=""), "gepp": MethodDescription("GE++")},
    "raw",
    ("psnr",),
    ("3dgs",),
    {"tanks_temples": SceneGroup("Tanks & Temples", ("train", "truck"))},
)
GREEN, BLUE, RED = (0, 200, 0), (0, 0, 200), (200, 0, 0)


def spotted(colour: tuple[int, int, int], size: tuple[int, int] = (60, 48)) -> Image.Image:
    """A black image with a spot in its right bottom corner."""
    image = Image.new("RGB", size)
    ImageDraw.Draw(image).rectangle((size[0] * 0.75, size[1] * 0.75, *size), fill=colour)
    return image


@pytest.fixture
def images(tmp_path: Path) -> dict[tuple[str, str], Path]:
    found = {}
    for scene in ("train", "truck"):
        for method, picture in {"raw": spotted(RED), "gepp": spotted(BLUE), PHOTO: spotted(GREEN)}.items():
            found[scene, method] = tmp_path / f"{scene}-{method}.png"
            picture.save(found[scene, method])
    return found


def count(path: Path, colour: tuple[int, int, int]) -> int:
    colours = Image.open(path).convert("RGB").getcolors(1_000_000)
    return {c: n for n, c in colours or []}[colour]


def test_the_crop_is_where_the_render_is_farthest_from_its_photo() -> None:
    assert crop_box(spotted(RED), Image.new("RGB", (60, 48))) == pytest.approx((2 / 3, 2 / 3, 1, 1))
    turned = spotted(RED).transpose(Image.Transpose.ROTATE_180)
    assert crop_box(turned, Image.new("RGB", (240, 192)))[:2] == (0, 0)  # of another resolution


def test_every_scene_and_row_is_shown(tmp_path: Path, images: dict) -> None:
    path = write_grid(tmp_path / "figure_7.png", TABLE, images, height=48)
    assert count(path, RED) == count(path, BLUE)  # the same crop in each column
    assert count(path, GREEN) > count(path, BLUE)  # once as a crop, once as the whole view
    assert count(path, BLUE) == pytest.approx(2 * 60 * 48 * 0.75**2, rel=0.05)  # the spot fills 9/16 of each crop
    grid = Image.open(path)
    assert grid.width > 4 * 60
    assert grid.height > 2 * 48


def test_rows_of_other_resolutions_show_the_same_crop(tmp_path: Path, images: dict) -> None:
    path = write_grid(tmp_path / "same.png", TABLE, images, height=48)
    spotted(BLUE, (240, 192)).save(images["train", "gepp"])
    finer = write_grid(tmp_path / "finer.png", TABLE, images, height=48)
    assert count(finer, BLUE) == pytest.approx(count(path, BLUE), rel=0.1)


def test_what_is_missing_is_a_tile_that_says_so(tmp_path: Path, images: dict) -> None:
    whole = Image.open(write_grid(tmp_path / "whole.png", TABLE, images, height=48))
    images.pop(("truck", "gepp"))
    path = write_grid(tmp_path / "gap.png", TABLE, images, height=48)
    gap = Image.open(path)
    assert gap.size == whole.size
    box = ImageChops.difference(whole, gap).getbbox()
    assert box is not None
    assert (box[2] - box[0], box[3] - box[1]) == (60, 48)
    assert count(path, (30, 30, 30)) > 0


def test_the_order_of_the_images_changes_nothing(tmp_path: Path, images: dict) -> None:
    one = write_grid(tmp_path / "one.png", TABLE, images)
    two = write_grid(tmp_path / "two.png", TABLE, dict(reversed(list(images.items()))))
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.parametrize("wrong", ["nothing", "row", "file", "gone"])
def test_refuses_by_name(tmp_path: Path, images: dict, wrong: str) -> None:
    if wrong == "file":
        images["train", "raw"].write_bytes(b"no image")
    if wrong == "gone":
        images["train", "raw"].unlink()
    given = {"nothing": {}, "row": {("train", "other"): images["train", "raw"]}}.get(wrong, images)
    with pytest.raises(InputError, match=r"no image|'other'|train-raw"):
        write_grid(tmp_path / "grid.png", TABLE, given)
    assert not (tmp_path / "grid.png").exists()


def test_a_given_crop_takes_the_place_of_the_largest_error(tmp_path: Path, images: dict) -> None:
    corner = {"train": (0.0, 0.0, 1 / 3, 1 / 3)}
    path = write_grid(tmp_path / "figure_7.png", TABLE, images, height=48, boxes=corner)
    whole = write_grid(tmp_path / "whole.png", TABLE, images, height=48)
    assert count(path, BLUE) == pytest.approx(count(whole, BLUE) / 2, rel=0.05)  # the other scene's alone
