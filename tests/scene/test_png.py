"""Encoded PNGs: every pixel kept, one stream whatever the number of threads, and about PIL's size."""

import io
import zlib

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.scene import png
from gaussian_enhancer.scene.png import encode_png


def noise(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 1), (45, 52)])
@pytest.mark.parametrize("strip", [1, 500, png.STRIP])
def test_every_pixel_is_kept(size: tuple[int, int], strip: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(png, "STRIP", strip)
    image = Image.open(io.BytesIO(encode_png(noise(*size))))
    image.verify()
    read = Image.open(io.BytesIO(encode_png(noise(*size))))
    assert (read.format, read.mode) == ("PNG", "RGB")
    assert np.array_equal(np.asarray(read), noise(*size))


def test_pixels_need_not_lie_in_order() -> None:
    turned = noise(20, 30).transpose(1, 0, 2)
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(encode_png(turned)))), turned)


def test_the_file_does_not_depend_on_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(png, "STRIP", 1000)
    files = []
    for threads in (1, 3):
        monkeypatch.setattr(torch, "get_num_threads", lambda threads=threads: threads)
        files.append(encode_png(noise(40, 50)))
    assert files[0] == files[1]


def test_smooth_images_are_as_small_as_pil_writes_them() -> None:
    x, y = np.meshgrid(np.arange(300), np.arange(200))
    image = np.stack([x // 2, y, (x + y) // 3], axis=-1).astype(np.uint8) + noise(200, 300) // 64
    written = io.BytesIO()
    Image.fromarray(image).save(written, "PNG", compress_type=zlib.Z_RLE)
    assert len(encode_png(image)) < 1.1 * len(written.getvalue())
