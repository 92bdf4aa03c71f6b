import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.splits import Split
from gaussian_enhancer.scene.transforms import load_nerf_synthetic, load_transforms
from support.captures_on_disk import (
    COUNT,
    DOT,
    FX,
    FY,
    HEIGHT,
    WIDTH,
    assert_dots_are_where_cameras_say,
    dot_centre,
    dot_image,
    fisheye,
    opencv,
    opengl_to_world,
    pose,
    predicted_dot,
    write_transforms,
)


def rewrite(root, content):
    (root / "transforms.json").write_text(json.dumps(content))


def write_synthetic(root, angle=0.7, count=3):
    """NeRF-Synthetic: a black dot's alpha on nothing, blender's camera x = w/2 - f X/Z with Z backward."""
    focal = WIDTH / (2 * math.tan(angle / 2))
    for side in ("train", "val", "test"):
        frames = []
        for i in range(count):
            rotation, translation = pose(i + 2 * (side == "test"))
            x, y, z = rotation @ DOT + translation
            alpha = dot_image(WIDTH / 2 + focal * x / z, HEIGHT / 2 + focal * y / z)
            pixels = np.zeros((HEIGHT, WIDTH, 4), np.uint8)
            pixels[..., 3] = (alpha * 255).round()
            (root / side).mkdir(exist_ok=True)
            Image.fromarray(pixels).save(root / side / f"r_{i}.png")
            matrix = opengl_to_world(i + 2 * (side == "test"))
            frames.append({"file_path": f"./{side}/r_{i}", "rotation": 0.01, "transform_matrix": matrix})
        content = {"camera_angle_x": angle, "frames": frames}
        (root / f"transforms_{side}.json").write_text(json.dumps(content))


def test_known_point_lands_on_its_pixel(tmp_path):
    write_transforms(tmp_path)
    scene = load_transforms(tmp_path)
    assert len(scene.photos) == COUNT
    assert scene.photos[0].camera.K[0, 0] == FX
    assert_dots_are_where_cameras_say(scene)
    assert scene.test == (0, 8)


@pytest.mark.parametrize("ending", [".png", ".PNG"])
def test_photos_are_found_where_frames_omit_their_ending(tmp_path, ending):
    content = write_transforms(tmp_path)
    for frame in content["frames"]:
        photo = tmp_path / frame["file_path"]
        photo.rename(photo.with_suffix(ending))
        frame["file_path"] = frame["file_path"].removesuffix(".png")
    rewrite(tmp_path, content)
    assert {Path(photo.name).suffix for photo in load_transforms(tmp_path).photos} == {ending}


def test_instant_ngp_distortion_is_undone(tmp_path):
    write_transforms(tmp_path, opencv(-0.2, 0.05, 0.004, -0.003), k1=-0.2, k2=0.05, p1=0.004, p2=-0.003)
    assert_dots_are_where_cameras_say(load_transforms(tmp_path), atol=0.12)


@pytest.mark.parametrize("values", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}])
def test_fisheye_is_undone(tmp_path, values):
    write_transforms(tmp_path, fisheye(0.02, -0.01), k1=0.02, k2=-0.01, **values)
    assert_dots_are_where_cameras_say(load_transforms(tmp_path), atol=0.12)


def test_intrinsics_of_each_frame(tmp_path):
    content = write_transforms(tmp_path)
    shared = {key: content.pop(key) for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")}
    for frame in content["frames"]:
        frame.update(shared)
    rewrite(tmp_path, content)
    assert_dots_are_where_cameras_say(load_transforms(tmp_path))


def test_downscale(tmp_path):
    write_transforms(tmp_path)
    scene = load_transforms(tmp_path, downscale=2)
    assert scene.photos[0].camera.width == WIDTH // 2
    assert_dots_are_where_cameras_say(scene)


def test_angle_stands_in_for_focal_length(tmp_path):
    content = write_transforms(tmp_path)
    del content["fl_x"], content["fl_y"]
    content["camera_angle_x"] = 2 * math.atan(WIDTH / (2 * FX))
    content["camera_angle_y"] = 2 * math.atan(HEIGHT / (2 * FY))
    rewrite(tmp_path, content)
    K = load_transforms(tmp_path).photos[0].camera.K
    assert K[0, 0] == pytest.approx(FX)
    assert K[1, 1] == pytest.approx(FY)


def test_nerf_synthetic_over_white_with_its_own_split(tmp_path):
    write_synthetic(tmp_path)
    scene = load_nerf_synthetic(tmp_path)
    names = [photo.name for photo in scene.photos]
    assert names == [f"{side}_r_{i}.png" for side in ("test", "train", "val") for i in range(3)]
    assert (scene.train, scene.test) == ((3, 4, 5), (0, 1, 2))
    assert scene.background == (1.0, 1.0, 1.0)
    for photo in scene.photos:
        image, alpha = photo.read(), photo.read_alpha()
        torch.testing.assert_close(image, (1 - alpha).expand(3, -1, -1))
        np.testing.assert_allclose(dot_centre(alpha.numpy()), predicted_dot(photo.camera), atol=0.05)
    assert load_nerf_synthetic(tmp_path, split=Split(train_every=2)).train == (3, 5)
    assert load_nerf_synthetic(tmp_path, background=(0.0, 0.0, 0.0)).photos[0].read().max() == 0


def test_nerfstudio_lists_are_the_split(tmp_path):
    content = write_transforms(tmp_path)
    paths = [frame["file_path"] for frame in content["frames"]]
    rewrite(tmp_path, {**content, "train_filenames": paths[:5], "test_filenames": paths[5:7]})
    scene = load_transforms(tmp_path)
    assert (scene.train, scene.test) == ((0, 1, 2, 3, 4), (5, 6))
    assert load_transforms(tmp_path, split=Split(own=False)).test == (0, 8)
    rewrite(tmp_path, {**content, "train_filenames": paths, "test_filenames": paths[:1]})
    with pytest.raises(InputError, match=r"view_00\.png for training and for testing"):
        load_transforms(tmp_path)


@pytest.mark.parametrize("form", ["images/{}", "./images/{}.png", "images\\{}.png", "images/{}.jpg"])
@pytest.mark.parametrize("ending", ["", ".png"])
def test_lists_of_a_split_may_write_paths_in_another_form_than_the_frames(tmp_path, form, ending):
    content = write_transforms(tmp_path)
    stems = [frame["file_path"].removeprefix("images/").removesuffix(".png") for frame in content["frames"]]
    frames = [
        {**frame, "file_path": f"images/{stem}{ending}"} for frame, stem in zip(content["frames"], stems, strict=True)
    ]
    names = [form.format(stem) for stem in stems]
    rewrite(tmp_path, {**content, "frames": frames, "train_filenames": names[:5], "test_filenames": names[5:7]})
    scene = load_transforms(tmp_path)
    assert (scene.train, scene.test) == ((0, 1, 2, 3, 4), (5, 6))
    rewrite(tmp_path, {**content, "train_filenames": names, "test_filenames": [frames[0]["file_path"]]})
    with pytest.raises(InputError, match="for training and for testing"):
        load_transforms(tmp_path)


def test_names_in_lists_of_a_split_that_no_frame_has_are_refused_or_dropped(tmp_path):
    content = write_transforms(tmp_path)
    paths = [frame["file_path"] for frame in content["frames"]]
    lists = {"train_filenames": [*paths[:5], "images/other.png"], "test_filenames": paths[5:7]}
    rewrite(tmp_path, {**content, **lists})
    with pytest.raises(InputError, match=r"1 names .*that no frame has: images/other.*missing=drop"):
        load_transforms(tmp_path)
    (tmp_path / paths[0]).unlink()
    scene = load_transforms(tmp_path, missing="drop")
    assert (scene.train, scene.test) == ((0, 1, 2, 3), (4, 5))


def test_nerfstudio_points(tmp_path):
    content = write_transforms(tmp_path, ply_file_path="points.ply")
    header = "ply\nformat ascii 1.0\nelement vertex 1\n"
    fields = "".join(f"property float {a}\n" for a in "xyz")
    fields += "".join(f"property uchar {band}\n" for band in ("red", "green", "blue"))
    (tmp_path / "points.ply").write_text(header + fields + "end_header\n1 2 3 255 51 0\n")
    points = load_transforms(tmp_path).points
    torch.testing.assert_close(points.positions, torch.tensor([[1.0, 2.0, 3.0]]))
    torch.testing.assert_close(points.colours, torch.tensor([[1.0, 0.2, 0.0]]))
    rewrite(tmp_path, {**content, "ply_file_path": "none.ply"})
    with pytest.raises(InputError, match=r"none\.ply"):
        load_transforms(tmp_path)


def test_listed_but_missing_frames_are_counted_and_named_or_dropped(tmp_path):
    write_transforms(tmp_path)
    for i in range(1, 7):
        (tmp_path / f"images/view_{i:02d}.png").unlink()
    with pytest.raises(InputError, match=r"6 frames .*view_01\.png.*view_04\.png, \.\.\..*missing=drop"):
        load_transforms(tmp_path)
    assert [p.name for p in load_transforms(tmp_path, missing="drop").photos] == [
        "view_00.png",
        "view_07.png",
        "view_08.png",
    ]


def test_malformed_json_names_its_line(tmp_path):
    (tmp_path / "transforms.json").write_text('{\n "frames": [\n  {"file_path": }\n ]\n}')
    with pytest.raises(InputError, match=r"transforms\.json.*line 3"):
        load_transforms(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("frames"), "frames"),
        (lambda c: c.update(frames=[]), "lists no frames"),
        (lambda c: c["frames"][2].pop("transform_matrix"), "frame images/view_02.png.*transform_matrix"),
        (lambda c: c["frames"][2]["transform_matrix"][0].__setitem__(3, float("nan")), "view_02.*NaN"),
        (
            lambda c: c["frames"][0]["transform_matrix"][0].__setitem__(3, 1e300),
            r"view_00\.png: has a pose with the value 1e\+300",
        ),
        (lambda c: c["frames"][2].update(transform_matrix=[[1, 2], [3, 4]]), "view_02.*shape"),
        (lambda c: c["frames"][2].update(transform_matrix=np.zeros((4, 4)).tolist()), "view_02.*singular"),
        (lambda c: c["frames"][2].update(transform_matrix=np.diag([2.0, 2, 2, 1]).tolist()), "view_02.*scales"),
        (lambda c: c["frames"][2].update(transform_matrix=np.diag([-1.0, 1, 1, 1]).tolist()), "view_02.*mirrored"),
        (lambda c: c.update(fl_x=0), "focal length 0"),
        (lambda c: c.update(fl_x="wide"), "fl_x = 'wide'"),
        (lambda c: c.update(w=HEIGHT, h=WIDTH), "64x48 but its camera is 48x64"),
        (lambda c: c.update(camera_model="EQUIRECTANGULAR"), "EQUIRECTANGULAR"),
        (lambda c: (c.pop("fl_x"), c.update(camera_angle_x=0.0)), "field of view of 0"),
        (lambda c: (c.pop("fl_x"), c.pop("fl_y"), c.update(camera_angle_x=1e-300)), "focal length"),
        (lambda c: c.pop("fl_x"), "camera_angle_x"),
        (lambda c: c.update(frames=c["frames"][:1]), "1 usable photo"),
        (lambda c: c.update(frames=c["frames"] * 2), "more than once"),
    ],
)
def test_unusable_values_are_named(tmp_path, change, message):
    content = write_transforms(tmp_path)
    change(content)
    rewrite(tmp_path, content)
    with pytest.raises(InputError, match=message):
        load_transforms(tmp_path)


def test_one_lens_far_off_axis_keeps_fy(tmp_path):
    write_transforms(tmp_path)
    assert load_transforms(tmp_path).photos[0].camera.K[1, 1] == FY


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"fl_x": 1e-300}, "focal length 1e-300"),
        ({"cx": math.inf}, "has cx = inf"),
        ({"cx": 1e30}, "principal point"),
        ({"w": math.nan}, "has w = nan"),
        ({"w": math.inf}, "has w = inf"),
        ({"h": 10.5}, "has h = 10.5"),
        ({"train_filenames": 5, "test_filenames": []}, "train_filenames = 5"),
        ({"train_filenames": []}, "train_filenames alone"),
        ({"train_filenames": [[]], "test_filenames": []}, "train_filenames"),
        ({"camera_model": [1] * 1000}, "camera_model"),
    ],
)
def test_values_that_no_camera_has_are_refused(tmp_path, values, message):
    write_transforms(tmp_path, **values)
    with pytest.raises(InputError, match=message):
        load_transforms(tmp_path)
