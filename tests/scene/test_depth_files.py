import io
import zipfile

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.depth_files import ReadDepth, depth_size, find_depth

DEPTH = np.random.default_rng(0).uniform(0.5, 4, (5, 7)).astype(np.float32)


@pytest.mark.parametrize("shape", [(5, 7), (1, 5, 7), (5, 7, 1)])
@pytest.mark.parametrize("ending", [".npy", ".npz"])
def test_arrays(tmp_path, shape, ending):
    path = tmp_path / f"a{ending}"
    (np.save if ending == ".npy" else np.savez)(path, DEPTH.reshape(shape))
    assert depth_size(path) == (5, 7)
    torch.testing.assert_close(ReadDepth(path, 2.0)(), torch.from_numpy(2 * DEPTH)[None])
    assert find_depth(tmp_path, "a") == path
    assert find_depth(tmp_path, "b") is None


def test_sixteen_bit_png_with_scale(tmp_path):
    Image.fromarray((DEPTH * 1000).astype(np.uint16)).save(tmp_path / "a.png")
    assert depth_size(tmp_path / "a.png") == (5, 7)
    torch.testing.assert_close(ReadDepth(tmp_path / "a.png", 0.001)()[0], torch.from_numpy(DEPTH), atol=1e-3, rtol=0)


def test_background_written_as_nan_or_infinity_is_zero(tmp_path):
    depth = DEPTH.copy()
    depth[0, :3] = (np.nan, np.inf, -np.inf)
    np.save(tmp_path / "a.npy", depth)
    read = ReadDepth(tmp_path / "a.npy")()
    assert read[0, 0, :3].tolist() == [0, 0, 0]
    torch.testing.assert_close(read[0, 1:], torch.from_numpy(DEPTH[1:]))


@pytest.mark.parametrize("ending", [".npy", ".npz", ".png"])
@pytest.mark.parametrize("keep", [0, 40, -50])
def test_truncated_files_are_named(tmp_path, ending, keep):
    path = tmp_path / f"a{ending}"
    if ending == ".png":
        Image.fromarray((DEPTH * 1000).astype(np.uint16)).save(path)
    else:
        (np.save if ending == ".npy" else np.savez)(path, DEPTH)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(InputError, match=rf"a\{ending}.*bytes"):
        ReadDepth(path)()


def test_negative_depth_and_odd_arrays_are_refused(tmp_path):
    np.save(tmp_path / "negative.npy", -DEPTH)
    np.save(tmp_path / "colour.npy", np.zeros((5, 7, 3)))
    np.savez(tmp_path / "two.npz", a=DEPTH, b=DEPTH)
    np.save(tmp_path / "object.npy", np.array([{"a": 1}], dtype=object))
    for name, message in [
        ("negative.npy", "depth -"),
        ("colour.npy", "shape"),
        ("two.npz", "named depth"),
        ("object.npy", "holds object"),
    ]:
        with pytest.raises(InputError, match=message):
            ReadDepth(tmp_path / name)()


@pytest.mark.parametrize("scale", [0, -1, float("nan"), float("inf"), None, True])
def test_a_scale_that_is_no_positive_number_is_refused(tmp_path, scale):
    reader = ReadDepth(tmp_path / "a.npy")
    object.__setattr__(reader, "scale", scale)  # the tests' own shape checks would stop a constructor's argument
    with pytest.raises(InputError, match=r"depth_scale: is "):
        reader.__post_init__()


def test_depth_that_would_overflow_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.full((5, 7), 1e38, np.float32))
    with pytest.raises(InputError, match=r"a\.npy: has depth 1e\+38"):
        ReadDepth(tmp_path / "a.npy")()


def test_a_depth_map_larger_than_the_limit_is_refused_from_its_header(tmp_path):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (36000, 36000)})
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("depth.npy", header.getvalue() + bytes(1000))
    with pytest.raises(InputError, match=r"a\.npz: is a depth map of shape \(36000, 36000\), which takes up to"):
        depth_size(tmp_path / "a.npz")


@pytest.mark.parametrize(("name", "content"), [("depth.txt", b"hello"), ("depth.npy", b"hello"), ("depth.npy", b"")])
def test_members_that_are_no_arrays_are_refused(tmp_path, name, content):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr(name, content)
    with pytest.raises(InputError, match=r"a\.npz: cannot be decoded"):
        depth_size(tmp_path / "a.npz")


def test_depth_in_a_palette_is_refused(tmp_path):
    Image.fromarray(np.zeros((5, 7), np.uint8)).convert("P").save(tmp_path / "a.png")
    with pytest.raises(InputError, match="mode P"):
        depth_size(tmp_path / "a.png")
