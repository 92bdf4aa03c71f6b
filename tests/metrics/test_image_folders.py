from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.image_folders import Label, image_digest, measure_files, pair_folders, pair_run
from gaussian_enhancer.scene.photos import read_photo

LABEL = Label("run", "fox", "3dgs", "enhanced")


def save(path: Path, value: int = 100, size: tuple[int, int] = (24, 20), channels: int = 3) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.full((size[1], size[0], channels), value, np.uint8)
    Image.fromarray(pixels.squeeze() if channels == 1 else pixels).save(path)
    return path


@pytest.fixture
def folders(tmp_path: Path) -> Path:
    for i, name in enumerate(("b", "a")):
        save(tmp_path / "images" / f"{name}.png", 100 + i)
        save(tmp_path / "photos" / f"{name}.JPG", 110)
    save(tmp_path / "photos" / "c.jpg", size=(3, 3))
    return tmp_path


def test_names_without_ending_match_and_other_photos_are_left_alone(folders: Path) -> None:
    found = pair_folders(folders / "images", folders / "photos", LABEL)
    assert [(f.image.name, f.photo.name) for f in found] == [("a.png", "a.JPG"), ("b.png", "b.JPG")]


def test_a_missing_photo_is_refused_or_dropped(folders: Path) -> None:
    (folders / "photos" / "b.JPG").unlink()
    with pytest.raises(InputError, match=r"b\.png: has no photo in .*\(1 of 2 images have none\); .*unmatched=drop"):
        pair_folders(folders / "images", folders / "photos", LABEL)
    found = pair_folders(folders / "images", folders / "photos", LABEL, unmatched="drop")
    assert [f.image.name for f in found] == ["a.png"]


def test_folders_that_share_nothing_are_refused(folders: Path) -> None:
    save(folders / "other" / "z.png")
    with pytest.raises(InputError, match="shares no file name"):
        pair_folders(folders / "other", folders / "photos", LABEL, unmatched="drop")


def test_sizes_are_checked_before_anything_is_measured(folders: Path) -> None:
    save(folders / "photos" / "b.JPG", size=(24, 21))
    with pytest.raises(InputError, match=r"b\.JPG: is 24x21 where .*b\.png is 24x20"):
        pair_folders(folders / "images", folders / "photos", LABEL)


def test_two_images_of_one_name_are_refused(folders: Path) -> None:
    save(folders / "images" / "a.jpg")
    with pytest.raises(InputError, match="keep one image of each name"):
        pair_folders(folders / "images", folders / "photos", LABEL)


def test_masks_are_needed_for_all_or_none(folders: Path) -> None:
    mask = save(folders / "masks" / "a.png", 255, channels=1)
    with pytest.raises(InputError, match=r"masks: has no mask for b\.png"):
        pair_folders(folders / "images", folders / "photos", LABEL, masks=folders / "masks")
    save(folders / "masks" / "b.png", 0, channels=1)
    found = pair_folders(folders / "images", folders / "photos", LABEL, masks=folders / "masks")
    assert found[0].mask == mask
    a, b = measure_files(found)
    assert a.metrics["psnr_masked"] == pytest.approx(a.metrics["psnr"])
    assert b.metrics["psnr_masked"] is None
    assert "empty" in b.reasons["psnr_masked"]


def test_records_name_what_was_measured(folders: Path) -> None:
    first, _ = measure_files(pair_folders(folders / "images", folders / "photos", LABEL))
    assert (first.kind, first.run, first.scene, first.view, first.size) == ("quality", "run", "fox", "a.png", (24, 20))
    assert first.metrics["psnr"] == pytest.approx(-20 * np.log10(9 / 255), abs=0.5)  # the photo went through JPEG


def test_records_tell_whether_they_had_the_same_photo(folders: Path) -> None:
    first, second = measure_files(pair_folders(folders / "images", folders / "photos", LABEL))
    assert first.photo == second.photo == image_digest(read_photo(folders / "photos" / "a.JPG"))
    save(folders / "photos" / "b.JPG", 111)
    kept, changed = measure_files(pair_folders(folders / "images", folders / "photos", LABEL))
    assert kept.photo == first.photo != changed.photo
    assert image_digest(torch.zeros(3, 2, 4)) != image_digest(torch.zeros(3, 4, 2))


def test_a_run_has_raw_and_enhanced_against_its_photos(tmp_path: Path) -> None:
    for step in (30, 7):
        for part in ("renders", "gt", "enhanced"):
            save(tmp_path / "test" / f"ours_{step}" / part / "00000.png")
    found = pair_run(tmp_path)
    assert [(f.label.variant, f.label.splat) for f in found] == [("raw", "ours_30"), ("enhanced", "ours_30")]
    assert pair_run(tmp_path, 7)[0].label.splat == "ours_7"
    with pytest.raises(InputError, match="no renders of step 8; choose one of 7, 30"):
        pair_run(tmp_path, 8)
    with pytest.raises(InputError, match=r"holds no test/ours_<step>/renders"):
        pair_run(tmp_path / "test")
