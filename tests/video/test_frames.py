import pytest
import torch
from PIL import Image

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import quantise_8_bit
from gaussian_enhancer.video.frames import FrameFolder, frame_name


def test_a_frame_comes_back_with_its_candidates(tmp_path):
    folder = FrameFolder(tmp_path / "frames")
    image = quantise_8_bit(torch.rand(3, 6, 8))
    assert not folder.has(3)
    folder.write(3, image, ["b.png", "ä.png"])
    assert folder.has(3)
    assert torch.equal(folder.read(3), image)
    assert folder.candidates(3) == ("b.png", "ä.png")
    assert [path.name for path in (tmp_path / "frames").iterdir()] == [frame_name(3)]


def test_names_sort_as_frames_do():
    assert sorted(map(frame_name, (100000, 20, 3))) == [frame_name(3), frame_name(20), frame_name(100000)]


def test_another_image_in_its_place_is_refused(tmp_path):
    Image.new("RGB", (4, 4)).save(tmp_path / frame_name(0))
    (tmp_path / frame_name(1)).write_bytes(b"x")
    for index in (0, 1):
        with pytest.raises(InputError, match="is no frame of an enhanced video"):
            FrameFolder(tmp_path).candidates(index)
