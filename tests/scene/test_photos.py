import numpy as np
import pytest
import torch
from omegaconf import ListConfig
from PIL import Image

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.photos import (
    background_colour,
    composite,
    decode,
    downscaled_size,
    list_images,
    read_coverage,
    read_header,
    read_photo,
    resize,
)
from support.captures_on_disk import write_deep_png


def noise(*shape, top=256, dtype=np.uint8):
    return np.random.default_rng(0).integers(0, top, shape).astype(dtype)


def test_eight_bits_are_exact(tmp_path):
    values = noise(5, 7, 3)
    Image.fromarray(values).save(tmp_path / "a.png")
    expected = torch.from_numpy(values).permute(2, 0, 1) / 255
    torch.testing.assert_close(decode(tmp_path / "a.png"), expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize("channels", [2, 3, 4])
def test_sixteen_bits_keep_their_depth(tmp_path, channels):
    values = noise(5, 7, channels, top=65536, dtype=np.uint16)
    write_deep_png(tmp_path / "a.png", values)
    image = decode(tmp_path / "a.png")
    assert image.shape[0] == (3 if channels == 3 else 4)
    np.testing.assert_allclose(image[0].numpy() * 65535, values[..., 0], atol=0.01)
    np.testing.assert_allclose(image[-1].numpy() * 65535, values[..., -1], atol=0.01)


def test_sixteen_bit_grey(tmp_path):
    values = noise(5, 7, top=65536, dtype=np.uint16)
    Image.fromarray(values).save(tmp_path / "a.png")
    image = decode(tmp_path / "a.png")
    assert image.shape == (3, 5, 7)
    np.testing.assert_allclose(image[2].numpy() * 65535, values, atol=0.01)


def test_grey_palette_and_bilevel_become_rgb(tmp_path):
    grey = Image.fromarray(noise(5, 7))
    for name, image in {"g": grey, "p": grey.convert("RGB").convert("P"), "b": grey.convert("1")}.items():
        image.save(tmp_path / f"{name}.png")
        assert decode(tmp_path / f"{name}.png").shape == (3, 5, 7)


def test_alpha_is_laid_over_the_background(tmp_path):
    values = np.zeros((1, 3, 4), np.uint8)
    values[0, :, 0] = 255
    values[0, :, 3] = (0, 51, 255)
    Image.fromarray(values).save(tmp_path / "a.png")
    image = read_photo(tmp_path / "a.png", (0.0, 1.0, 0.5))
    torch.testing.assert_close(image[:, 0, 0], torch.tensor([0.0, 1.0, 0.5]))
    torch.testing.assert_close(image[:, 0, 1], torch.tensor([0.2, 0.8, 0.4]))
    torch.testing.assert_close(image[:, 0, 2], torch.tensor([1.0, 0.0, 0.0]))
    torch.testing.assert_close(read_coverage(tmp_path / "a.png")[0, 0], torch.tensor([0.0, 0.2, 1.0]))
    assert read_header(tmp_path / "a.png").has_alpha


def test_composite_leaves_opaque_images():
    image = torch.rand(3, 4, 4)
    assert composite(image, (1.0, 1.0, 1.0)) is image


def test_exif_orientation_is_not_applied(tmp_path):
    exif = Image.Exif()
    exif[274] = 6
    Image.fromarray(noise(5, 7, 3)).save(tmp_path / "a.jpg", exif=exif)
    assert decode(tmp_path / "a.jpg").shape == (3, 5, 7)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("compression", [None, "tiff_lzw"])
def test_tiff_is_not_turned_by_its_orientation(tmp_path, orientation, compression):
    values = noise(5, 7, 3)
    file = tmp_path / "a.tif"
    Image.fromarray(values).save(file, tiffinfo={274: orientation}, compression=compression)
    assert read_header(file).size == (5, 7)
    torch.testing.assert_close(decode(file), torch.from_numpy(values).permute(2, 0, 1) / 255)


def test_resize_equals_pil_up_to_its_rounding(tmp_path):
    values = noise(40, 60, 3)
    expected = np.asarray(Image.fromarray(values).resize((20, 10), Image.Resampling.BICUBIC)) / 255
    resized = resize(torch.from_numpy(values).permute(2, 0, 1) / 255, 10, 20)
    np.testing.assert_allclose(resized.permute(1, 2, 0).numpy(), expected, atol=1.1 / 255)


def test_resize_removes_what_the_new_grid_cannot_hold():
    stripes = (torch.arange(64) % 2).float().expand(3, 8, 64)
    assert resize(stripes, 8, 21).std() < 0.1


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[: len(data) // 2],
        lambda data: data[:20],
        lambda data: b"not an image at all",
    ],
)
@pytest.mark.parametrize("ending", [".png", ".jpg"])
def test_damaged_files_are_named(tmp_path, ending, damage):
    Image.fromarray(noise(50, 70, 3)).save(tmp_path / f"good{ending}")
    path = tmp_path / f"bad{ending}"
    path.write_bytes(damage((tmp_path / f"good{ending}").read_bytes()))
    with pytest.raises(InputError, match=rf"bad\{ending}.*bytes"):
        decode(path)


def test_damaged_deep_png_is_named(tmp_path):
    write_deep_png(tmp_path / "a.png", noise(50, 70, 3, top=65536, dtype=np.uint16))
    data = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(data[:3000])
    with pytest.raises(InputError, match=r"a\.png.*3000 bytes"):
        decode(tmp_path / "a.png")


def test_missing_photo_and_empty_folder_are_refused(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        decode(tmp_path / "none.png")
    with pytest.raises(InputError, match="holds no image"):
        list_images(tmp_path)
    with pytest.raises(InputError, match="is no folder"):
        list_images(tmp_path / "none")


def test_images_come_sorted_and_hidden_files_do_not_count(tmp_path):
    for name in ("b.png", "a.JPG", "._a.JPG", "notes.txt"):
        (tmp_path / name).touch()
    assert [p.name for p in list_images(tmp_path)] == ["a.JPG", "b.png"]


def test_float_pixels_are_refused(tmp_path):
    Image.fromarray(np.ones((4, 4), np.float32)).save(tmp_path / "a.tif")
    with pytest.raises(InputError, match="floating-point"):
        decode(tmp_path / "a.tif")


@pytest.mark.parametrize("downscale", [0.5, 0.0, -1.0, float("nan"), float("inf"), 1000.0])
def test_impossible_downscale_is_refused(downscale):
    with pytest.raises(InputError, match="downscale"):
        downscaled_size(30, 40, downscale)


def test_downscaled_size_rounds():
    assert downscaled_size(31, 45, 4) == (8, 11)


def test_an_image_larger_than_the_limit_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    Image.new("L", (500, 400)).save(tmp_path / "a.png")
    read_header(tmp_path / "a.png")
    monkeypatch.setenv("GAUSSIAN_ENHANCER_READ_LIMIT", "0.001")
    with pytest.raises(InputError, match=r"a\.png: is an image of 500x400 pixels, which takes up to"):
        decode(tmp_path / "a.png")


def test_other_formats_under_a_photos_name_are_no_images(tmp_path):
    (tmp_path / "a.png").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n")
    with pytest.raises(InputError, match=r"a\.png: is no image"):
        read_header(tmp_path / "a.png")


def test_a_background_of_whole_numbers_becomes_three_floats():
    assert background_colour(ListConfig([0, 1, 0.5])) == (0.0, 1.0, 0.5)


@pytest.mark.parametrize("values", [(0, 0), (0, 0, 0, 1), (0, 0, 255), (0, 0, float("nan")), ("0", 0, 0), (None, 0, 0)])
def test_a_background_that_is_no_colour_is_refused(values):
    with pytest.raises(InputError, match=r"background: .* give three numbers from 0 to 1"):
        background_colour(values)
