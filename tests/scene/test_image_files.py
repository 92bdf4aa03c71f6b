"""Written images: the same pixels in every lossless format, and PNGs that are compressed."""

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.scene.image_files import to_bytes, write_image

LEVELS = torch.arange(256).repeat(3, 12, 1)


@pytest.mark.parametrize("name", ["a.png", "a.PNG", "a.bmp", "a.tiff"])
def test_pixels_are_kept(tmp_path, name: str) -> None:
    write_image(tmp_path / name, LEVELS / 255)
    assert np.array_equal(np.asarray(Image.open(tmp_path / name)), LEVELS.permute(1, 2, 0).numpy())


def test_an_image_of_one_channel_is_grey(tmp_path) -> None:
    write_image(tmp_path / "grey.png", torch.full((1, 2, 3), 0.5))
    picture = Image.open(tmp_path / "grey.png")
    assert picture.mode == "L"
    assert np.array_equal(np.asarray(picture), np.full((2, 3), 128))


def test_a_png_is_compressed(tmp_path) -> None:
    write_image(tmp_path / "a.png", LEVELS / 255)
    assert (tmp_path / "a.png").stat().st_size < LEVELS.numel() / 4


@pytest.mark.parametrize("size", [(1, 1), (7, 9)])
@pytest.mark.parametrize("channels", [1, 3])
def test_compiled_pixels_equal_their_readable_twin(size: tuple[int, int], channels: int) -> None:
    image = 1.4 * torch.rand(channels, *size, generator=torch.Generator().manual_seed(0)) - 0.2
    pixels = to_bytes(image)
    assert np.array_equal(pixels, to_bytes(image.double()))
    assert np.array_equal(to_bytes(image.transpose(1, 2)), pixels.transpose(1, 0, 2))


def test_levels_and_ties_are_rounded_as_files_hold_them() -> None:
    halves = (LEVELS[:, :1, :255] + 0.5) / 255
    assert np.array_equal(to_bytes(LEVELS / 255), LEVELS.permute(1, 2, 0).numpy())
    assert np.array_equal(to_bytes(halves), (halves * 255).round().byte().permute(1, 2, 0).numpy())
