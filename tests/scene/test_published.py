"""Scenes of published datasets: which photos, which size, which side, and what is said where they are not there."""

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.pair import measure_pair
from gaussian_enhancer.scene.masks import write_masks
from gaussian_enhancer.scene.published import load_published, missing_parts
from gaussian_enhancer.scene.splits import Split
from support.captures_on_disk import COUNT, HEIGHT, WIDTH, colmap_to_binary, dot_centre, predicted_dot, write_colmap
from support.published_on_disk import write_pyramid, write_synthetic


@pytest.fixture
def garden(tmp_path):
    root = tmp_path / "mip_nerf_360" / "garden"
    write_pyramid(root)
    return root


@pytest.mark.parametrize("downscale", [1, 2, 4])
def test_mip_nerf_360_reads_its_authors_own_downscaled_photos(garden, downscale):
    scene = load_published(garden, dataset="mip_nerf_360", name="garden", photos=COUNT, downscale=downscale)
    folder = "images" if downscale == 1 else f"images_{downscale}"
    for photo in scene.photos:
        assert (photo.camera.height, photo.camera.width) == (HEIGHT // downscale, WIDTH // downscale)
        stored = np.asarray(Image.open(garden / folder / photo.name)).transpose(2, 0, 1) / 255
        np.testing.assert_allclose(photo.read().numpy(), stored, atol=1e-6)  # as stored, not resampled
        np.testing.assert_allclose(dot_centre(stored), predicted_dot(photo.camera), atol=0.1)
    assert scene.test == (0, 8)
    assert scene.train == (1, 2, 3, 4, 5, 6, 7)
    assert (scene.name, scene.background) == ("garden", (0.0, 0.0, 0.0))
    assert scene.points is not None


def test_sizes_that_its_authors_do_not_give_are_refused(garden):
    with pytest.raises(InputError, match=r"is 3 for Mip-NeRF 360; choose from 1, 2, 4, 8"):
        load_published(garden, dataset="mip_nerf_360", name="garden", downscale=3)


def test_missing_photos_name_the_command_that_fetches_them(garden):
    with pytest.raises(InputError) as caught:
        load_published(garden, dataset="mip_nerf_360", name="garden", downscale=8)
    assert caught.value.subject == str(garden / "images_8")
    command = (
        f"gaussian-enhancer download dataset=mip_nerf_360 scenes=[garden] images=[images_8] folder={garden.parents[1]}"
    )
    assert command in caught.value.remedy


def test_missing_scene_elsewhere_names_the_command_without_a_folder(tmp_path):
    with pytest.raises(
        InputError, match=r"dataset=tanks_temples scenes=\[truck\]\) and give its folder as scene\.path"
    ):
        load_published(tmp_path / "mine", dataset="tanks_temples", name="truck")


def test_another_number_of_photos_is_refused_and_can_be_accepted(garden):
    with pytest.raises(InputError, match=r"holds 9 photos where the published scene has 185.*scene\.photos=null"):
        load_published(garden, dataset="mip_nerf_360", name="garden", photos=185, downscale=4)
    assert len(load_published(garden, dataset="mip_nerf_360", name="garden", downscale=4).photos) == COUNT


@pytest.mark.parametrize(("dataset", "name"), [("tanks_temples", "train"), ("deep_blending", "playroom")])
def test_photos_of_half_the_calibrated_size_are_read_as_they_are(tmp_path, dataset, name):
    """Tanks and Temples' models are of photos twice as large as those in the archive."""
    root = tmp_path / dataset / name
    write_colmap(root)
    colmap_to_binary(root / "sparse/0")
    for path in (root / "images").iterdir():
        Image.open(path).resize((WIDTH // 2, HEIGHT // 2), Image.Resampling.BOX).save(path)
    scene = load_published(root, dataset=dataset, name=name, photos=COUNT)
    for photo in scene.photos:
        assert (photo.camera.height, photo.camera.width) == (HEIGHT // 2, WIDTH // 2)
        np.testing.assert_allclose(dot_centre(photo.read().numpy()), predicted_dot(photo.camera), atol=0.1)
    assert scene.test == (0, 8)


@pytest.fixture
def lego(tmp_path):
    root = tmp_path / "nerf_synthetic" / "lego"
    write_synthetic(root)
    return root


def test_nerf_synthetic_follows_its_own_split(lego):
    scene = load_published(lego, dataset="nerf_synthetic", name="lego", photos=9, split=Split())
    names = [photo.name for photo in scene.photos]
    assert [names[i] for i in scene.train] == [f"train_r_{i}.png" for i in range(4)]
    assert [names[i] for i in scene.test] == [f"test_r_{i}.png" for i in range(3)]
    assert not any("depth" in name for name in names)


@pytest.mark.parametrize("ground", [None, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)])
def test_nerf_synthetic_lies_over_white_unless_told_otherwise(lego, ground):
    scene = load_published(lego, dataset="nerf_synthetic", name="lego", background=ground)
    level = 1.0 if ground is None else ground[0]
    image = scene.test_photos[0].read()
    half = 128 / 255
    torch.testing.assert_close(image[:, 0, 0], torch.full((3,), level))  # not the green that is stored under nothing
    torch.testing.assert_close(image[:, 8, 8], torch.tensor([1.0, 0.0, 0.0]))
    rest = level * (1 - half)
    torch.testing.assert_close(image[:, 8, 4], torch.tensor([half + rest, rest, rest]))
    assert scene.background == (level,) * 3


def test_masked_quality_does_not_count_the_background(lego, tmp_path):
    scene = load_published(lego, dataset="nerf_synthetic", name="lego")
    files = write_masks(scene, tmp_path / "masks")
    assert [file.name for file in files] == ["test_r_0.png", "test_r_1.png", "test_r_2.png"]
    mask = torch.from_numpy(np.asarray(Image.open(files[0])) / np.float32(255))[None]
    torch.testing.assert_close(mask, scene.test_photos[0].read_alpha(), atol=1e-6, rtol=0)
    photo = scene.test_photos[0].read()
    render = torch.where(mask == 0, photo * 0.5, photo)  # wrong in the background alone
    metrics = measure_pair(render, photo, mask=mask).metrics
    assert metrics["psnr_masked"] == float("inf")
    assert metrics["psnr"] < 12


def test_photos_without_alpha_have_no_mask(garden, tmp_path):
    scene = load_published(garden, dataset="mip_nerf_360", name="garden", downscale=4)
    with pytest.raises(InputError, match="has no alpha channel"):
        write_masks(scene, tmp_path / "masks")


def test_missing_parts_are_all_named(tmp_path, lego):
    folder = tmp_path / "nothing"
    assert missing_parts(folder, "mip_nerf_360", 4) == (folder / "images_4", folder / "sparse/0")
    assert missing_parts(folder, "deep_blending") == (folder / "images", folder / "sparse/0")
    assert [path.name for path in missing_parts(folder, "nerf_synthetic")] == [
        "transforms_train.json",
        "train",
        "transforms_test.json",
        "test",
    ]
    assert missing_parts(lego, "nerf_synthetic") == ()
    with pytest.raises(InputError, match=r"choose from .*mip_nerf_360"):
        missing_parts(folder, "mip_nerf")
