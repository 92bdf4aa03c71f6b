"""What is written of enhanced views: at the size of their photos."""

import numpy as np
import torch
from PIL import Image

from gaussian_enhancer.infer.enhancer import EnhancedView
from gaussian_enhancer.runs.output import write_enhanced, write_sources
from gaussian_enhancer.scene.high_resolution import attach_fine_photos
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.photos import read_photo
from gaussian_enhancer.scene.posed import ReadPhoto
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.scene import Photo, Scene

WIDTH, HEIGHT = 110, 73  # of the photo; the render is 28x18: 4 times that is 112x72
SIZE = (28, 18)


def test_super_resolution_keeps_the_size_of_the_photo(tmp_path):
    photo = torch.rand(3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(0))
    write_image(tmp_path / "a.png", photo)
    view = RenderedView("a.png", lambda: torch.full((3, SIZE[1], SIZE[0]), 0.5))
    rendered = RenderedSet("set", (view,), ())
    scene = Scene("set", (Photo("a.png", None, ReadPhoto(tmp_path / "a.png", HEIGHT, WIDTH)),), (), (0,))
    finer = attach_fine_photos(rendered, scene)
    assert finer.targets[0].read_fine_photo().shape == (3, 72, 112)  # what networks see
    image = torch.full((3, 72, 112), 0.25)
    write_enhanced([EnhancedView("a.png", image, 1.0, 1.0, ())], tmp_path / "out/enhanced", finer, 4)
    write_sources(finer, tmp_path / "out", 4)
    for subfolder in ("enhanced", "renders", "gt"):
        assert Image.open(tmp_path / "out" / subfolder / "a.png").size == (WIDTH, HEIGHT), subfolder
    np.testing.assert_array_equal(
        np.asarray(Image.open(tmp_path / "out/gt/a.png")), np.asarray(Image.open(tmp_path / "a.png"))
    )
    assert torch.equal(read_photo(tmp_path / "out/enhanced/a.png"), torch.full((3, HEIGHT, WIDTH), 64 / 255))


def test_a_photo_is_never_written_as_a_jpeg(tmp_path):
    """A photo in another format than the render keeps its pixels; an unchanged file is copied."""
    photo = torch.rand(3, SIZE[1], SIZE[0], generator=torch.Generator().manual_seed(0))
    write_image(tmp_path / "photo.png", photo)
    write_image(tmp_path / "a.jpg", photo)
    render, other = (ReadPhoto(tmp_path / name, SIZE[1], SIZE[0]) for name in ("a.jpg", "photo.png"))
    view = RenderedView("a.jpg", render, read_photo=other)
    files = write_sources(RenderedSet("set", (view,), ()), tmp_path / "out", 1)
    assert [path.relative_to(tmp_path).as_posix() for path in files] == ["out/renders/a.jpg", "out/gt/a.png"]
    assert files[0].read_bytes() == (tmp_path / "a.jpg").read_bytes()
    assert torch.equal(read_photo(files[1]), other())


def test_at_the_renders_own_resolution_nothing_is_resized(tmp_path):
    view = RenderedView("a.png", lambda: torch.full((3, SIZE[1], SIZE[0]), 0.5), fine_size=(HEIGHT, WIDTH))
    image = torch.full((3, SIZE[1], SIZE[0]), 0.25)
    write_enhanced([EnhancedView("a.png", image, 1.0, 1.0, ())], tmp_path, RenderedSet("set", (view,), ()), 1)
    assert Image.open(tmp_path / "a.png").size == SIZE
