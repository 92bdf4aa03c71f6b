"""Written images: the same pixels in every lossless format, and PNGs that are compressed."""

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.scene.image_files import write_image

LEVELS = torch.arange(256).repeat(3, 12, 1)


@pytest.mark.parametrize("name", ["a.png", "a.PNG", "a.bmp", "a.tiff"])
def test_pixels_are_kept(tmp_path, name: str) -> None:
    write_image(tmp_path / name, LEVELS / 255)
    assert np.array_equal(np.asarray(Image.open(tmp_path / name)), LEVELS.permute(1, 2, 0).numpy())


def test_a_png_is_compressed(tmp_path) -> None:
    write_image(tmp_path / "a.png", LEVELS / 255)
    assert (tmp_path / "a.png").stat().st_size < LEVELS.numel() / 4
