import pickle

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.colmap import load_colmap
from gaussian_enhancer.scene.splits import Split
from support.captures_on_disk import (
    COUNT,
    CX,
    CY,
    DOT,
    FX,
    FY,
    HEIGHT,
    WIDTH,
    assert_dots_are_where_cameras_say,
    colmap_to_binary,
    fisheye,
    opencv,
    save,
    write_colmap,
)

HEAD = (FX, FY, CX, CY)


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("sparse", ["sparse/0", "sparse"])
def test_known_point_lands_on_its_pixel(tmp_path, binary, sparse):
    write_colmap(tmp_path, sparse=sparse)
    if binary:
        colmap_to_binary(tmp_path / sparse)
    scene = load_colmap(tmp_path)
    assert_dots_are_where_cameras_say(scene)
    torch.testing.assert_close(scene.points.positions, torch.tensor(DOT[None], dtype=torch.float32))
    torch.testing.assert_close(scene.points.colours, torch.tensor([[1.0, 0.2, 0.0]]))
    assert scene.test == (0, 8)
    assert scene.name == tmp_path.name


@pytest.mark.parametrize(
    ("model", "params", "lens"),
    [
        ("SIMPLE_PINHOLE", (FX, CX, CY), lambda p: np.array([FX, FX]) * p[:2] / p[2] + np.array([CX, CY])),
        ("OPENCV", (*HEAD, -0.2, 0.05, 0.004, -0.003), opencv(-0.2, 0.05, 0.004, -0.003)),
        ("OPENCV_FISHEYE", (*HEAD, 0.02, -0.01, 0.0, 0.0), fisheye(0.02, -0.01)),
    ],
)
def test_other_models_are_brought_to_pinholes(tmp_path, model, params, lens):
    write_colmap(tmp_path, model, params, lens)
    assert_dots_are_where_cameras_say(load_colmap(tmp_path), atol=0.12)


def test_downscaled_photos_carry_matching_cameras(tmp_path):
    write_colmap(tmp_path)
    scene = load_colmap(tmp_path, downscale=2)
    assert (scene.photos[0].camera.height, scene.photos[0].camera.width) == (HEIGHT // 2, WIDTH // 2)
    assert_dots_are_where_cameras_say(scene)


def test_smaller_photo_folder_rescales_the_intrinsics(tmp_path):
    for name in write_colmap(tmp_path):
        with Image.open(tmp_path / "images" / name) as image:
            small = image.resize((WIDTH // 2, HEIGHT // 2), Image.Resampling.BOX)
        save(tmp_path / "images_2" / name.replace(".png", ".bmp"), np.asarray(small)[..., 0] / 255)
    scene = load_colmap(tmp_path, images="images_2")
    assert scene.photos[0].name == "view_00.bmp"
    assert scene.photos[0].camera.K[0, 0] == pytest.approx(FX / 2)
    assert_dots_are_where_cameras_say(scene, atol=0.15)


def test_a_capture_with_smaller_photos_alone_names_the_option(tmp_path):
    write_colmap(tmp_path)
    (tmp_path / "images").rename(tmp_path / "images_2")
    with pytest.raises(InputError, match=r"images: is no folder; use scene=colmap scene\.images=images_2"):
        load_colmap(tmp_path)
    assert len(load_colmap(tmp_path, images="images_2").photos) > 1


def test_photos_with_another_aspect_are_refused(tmp_path):
    write_colmap(tmp_path)
    save(tmp_path / "images" / "view_03.png", np.zeros((WIDTH, HEIGHT)))
    with pytest.raises(InputError, match=r"view_03.*48x64 but its camera is 64x48"):
        load_colmap(tmp_path)


def test_scene_can_be_pickled_for_workers(tmp_path):
    write_colmap(tmp_path, "OPENCV", (*HEAD, -0.2, 0.05, 0.0, 0.0), opencv(-0.2, 0.05, 0, 0))
    scene = load_colmap(tmp_path)
    again = pickle.loads(pickle.dumps(scene))
    torch.testing.assert_close(again.photos[2].read(), scene.photos[2].read())


def test_unmatched_photos_and_cameras_are_named_or_dropped(tmp_path):
    write_colmap(tmp_path)
    save(tmp_path / "images" / "extra.png", np.zeros((HEIGHT, WIDTH)))
    with pytest.raises(InputError, match=r"1 photos without a camera: extra\.png.*missing=drop"):
        load_colmap(tmp_path)
    (tmp_path / "images" / "view_04.png").unlink()
    with pytest.raises(InputError, match=r"1 cameras without a photo: view_04\.png.*missing=drop"):
        load_colmap(tmp_path)
    scene = load_colmap(tmp_path, missing="drop")
    assert [p.name for p in scene.photos] == [f"view_{i:02d}.png" for i in range(COUNT) if i != 4]
    with pytest.raises(InputError, match="missing"):
        load_colmap(tmp_path, missing="ignore")


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("keep", [0, 4, 30, -5])
def test_truncated_binary_is_named(tmp_path, stem, keep):
    write_colmap(tmp_path)
    colmap_to_binary(tmp_path / "sparse/0")
    file = tmp_path / f"sparse/0/{stem}.bin"
    file.write_bytes(file.read_bytes()[:keep])
    with pytest.raises(InputError, match=rf"{stem}\.bin.*(truncated|records)"):
        load_colmap(tmp_path)


def test_malformed_text_and_missing_parts_are_named(tmp_path):
    write_colmap(tmp_path)
    images = tmp_path / "sparse/0/images.txt"
    text = images.read_text()
    images.write_text(text.replace(" 1 view_00.png", " one"))
    with pytest.raises(InputError, match="sparse/0"):
        load_colmap(tmp_path)
    images.write_text(text)
    (tmp_path / "sparse/0/points3D.txt").unlink()
    with pytest.raises(InputError, match=r"points3D\.txt.*does not exist"):
        load_colmap(tmp_path)


def test_zero_focal_is_named(tmp_path):
    write_colmap(tmp_path, params=(0.0, FY, CX, CY))
    with pytest.raises(InputError, match=r"camera 1 of .*focal length 0"):
        load_colmap(tmp_path)


def test_empty_and_single_photo_captures_are_refused(tmp_path):
    write_colmap(tmp_path)
    for photo in (tmp_path / "images").glob("view_0[1-9].png"):
        photo.unlink()
    with pytest.raises(InputError, match="1 usable photo"):
        load_colmap(tmp_path, missing="drop")
    (tmp_path / "images/view_00.png").unlink()
    with pytest.raises(InputError, match="holds no image"):
        load_colmap(tmp_path)
    with pytest.raises(InputError, match="is no folder"):
        load_colmap(tmp_path / "none")


def test_truncated_photo_is_named_when_read(tmp_path):
    write_colmap(tmp_path)
    photo = tmp_path / "images/view_02.png"
    photo.write_bytes(photo.read_bytes()[:200])
    scene = load_colmap(tmp_path)
    with pytest.raises(InputError, match=r"view_02\.png.*200 bytes"):
        scene.photos[2].read()


def test_sparse_split(tmp_path):
    write_colmap(tmp_path)
    scene = load_colmap(tmp_path, split=Split(test_every=4, train_every=3, unused_as_test=True))
    assert scene.train == (1, 5)
    assert scene.test == (0, 2, 3, 4, 6, 7, 8)


def damaged(folder, stem, change):
    file = folder / f"sparse/0/{stem}"
    file.write_text(change(file.read_text()))


@pytest.mark.parametrize(
    ("line", "first", "last", "values", "message"),
    [
        (1, 1, 5, "0 0 0 0", r"images\.txt: gives view_00\.png a quaternion of length 0"),
        (1, 1, 5, "nan 0 0 0", r"images\.txt: gives view_00\.png a quaternion of length nan"),
        (1, 5, 6, "1e300", r"view_00\.png: has a pose with the value"),
        (1, 5, 6, "1e20", r"view_00\.png: has a pose with the value"),
        (3, 5, 6, "nan", r"view_01\.png.*NaN|sparse/0"),
    ],
)
def test_a_pose_that_is_none_is_refused(tmp_path, line, first, last, values, message):
    write_colmap(tmp_path)

    def change(text):
        lines = text.split("\n")
        words = lines[line].split(" ")
        lines[line] = " ".join([*words[:first], values, *words[last:]])
        return "\n".join(lines)

    damaged(tmp_path, "images.txt", change)
    with pytest.raises(InputError, match=message):
        load_colmap(tmp_path)


def test_a_quaternion_of_zeros_in_a_binary_model_is_refused(tmp_path):
    write_colmap(tmp_path)
    colmap_to_binary(tmp_path / "sparse/0")
    file = tmp_path / "sparse/0/images.bin"
    data = file.read_bytes()
    file.write_bytes(data[:12] + bytes(32) + data[44:])
    with pytest.raises(InputError, match="a quaternion of length 0"):
        load_colmap(tmp_path)


def test_random_points_and_points_beyond_single_precision_are_refused(tmp_path):
    write_colmap(tmp_path)
    damaged(tmp_path, "points3D.txt", lambda text: text.replace("0.15", "1e300"))
    with pytest.raises(InputError, match="1 of 1 points that are not finite or too far away"):
        load_colmap(tmp_path)
    damaged(tmp_path, "points3D.txt", lambda text: text.replace("1e300", "0.15"))
    colmap_to_binary(tmp_path / "sparse/0")
    (tmp_path / "sparse/0/points3D.bin").write_bytes(np.random.default_rng(0).bytes(5000))
    with pytest.raises(InputError, match=r"points3D\.bin: is truncated or damaged \(5000 bytes\)"):
        load_colmap(tmp_path)


def test_names_that_are_no_utf8_and_numbers_twice_are_refused(tmp_path):
    write_colmap(tmp_path)
    damaged(tmp_path, "cameras.txt", lambda text: text + text)
    with pytest.raises(InputError, match=r"cameras\.txt: lists number 1 more than once"):
        load_colmap(tmp_path)
    damaged(tmp_path, "cameras.txt", lambda text: text[: len(text) // 2])
    images = tmp_path / "sparse/0/images.txt"
    images.write_bytes(images.read_bytes().replace(b"view_00", b"vi\xe9w_00"))
    with pytest.raises(InputError, match=r"is no UTF-8"):
        load_colmap(tmp_path)
    images.write_bytes(images.read_bytes().replace(b"vi\xe9w_00", b"view_00"))
    colmap_to_binary(tmp_path / "sparse/0")
    binary = tmp_path / "sparse/0/images.bin"
    binary.write_bytes(binary.read_bytes().replace(b"view_00", b"vi\xe9w_00"))
    with pytest.raises(InputError, match=r"images\.bin: lists the photo .*no UTF-8"):
        load_colmap(tmp_path)


@pytest.mark.parametrize("binary", [False, True])
def test_what_is_read_is_what_colmap_reads(tmp_path, binary):
    import pycolmap

    write_colmap(tmp_path)
    folder = tmp_path / "sparse/0"
    reference = pycolmap.Reconstruction(str(folder))
    if binary:
        colmap_to_binary(folder)
    poses = {photo.name: photo.camera.world_to_camera for photo in load_colmap(tmp_path).photos}
    assert set(poses) == {image.name for image in reference.images.values()}
    for image in reference.images.values():
        np.testing.assert_allclose(poses[image.name][:3], image.cam_from_world().matrix(), atol=1e-6)
