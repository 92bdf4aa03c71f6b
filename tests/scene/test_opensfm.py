import json
import warnings

import numpy as np
import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.opensfm import load_opensfm, rotation_from_axis_angle
from support.captures_on_disk import COUNT, DOT, HEIGHT, WIDTH, dot_centre, pose, write_photos
from support.projection import project

FOCAL, K1, K2 = 1.1, -0.12, 0.03


def perspective(local):
    """OpenSfM's own formula: normalised by the larger side, centred, then to pixels."""
    x, y = local[:2] / local[2]
    r2 = x * x + y * y
    bend = FOCAL * (1 + K1 * r2 + K2 * r2 * r2)
    size = max(WIDTH, HEIGHT)
    return np.array([x * bend * size + WIDTH / 2, y * bend * size + HEIGHT / 2])


def axis_angle(rotation):
    angle = np.arccos((np.trace(rotation) - 1) / 2)
    skew = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return (skew * angle / (2 * np.sin(angle))).tolist()


def write_opensfm(root, name="reconstruction.json", **camera):
    names = write_photos(root / "images", perspective)
    lens = {"projection_type": "perspective", "width": WIDTH, "height": HEIGHT, "focal": FOCAL, "k1": K1, "k2": K2}
    shots = {}
    for i, shot in enumerate(names):
        rotation, translation = pose(i)
        shots[shot] = {"rotation": axis_angle(rotation), "translation": translation.tolist(), "camera": "phone"}
    points = {"7": {"color": [255.0, 51.0, 0.0], "coordinates": DOT.tolist()}}
    content = [{"cameras": {"phone": {**lens, **camera}}, "shots": shots, "points": points}]
    (root / name).write_text(json.dumps(content))
    return content


@pytest.mark.parametrize("name", ["reconstruction.json", "reconstruction_example.json"])
def test_known_point_lands_on_its_pixel(tmp_path, name):
    write_opensfm(tmp_path, name)
    scene = load_opensfm(tmp_path)
    assert len(scene.photos) == COUNT
    for photo in scene.photos:
        pixel = project(photo.camera, scene.points.positions[0])
        np.testing.assert_allclose(dot_centre(photo.read().numpy()), pixel.numpy(), atol=0.12)
    torch.testing.assert_close(scene.points.colours, torch.tensor([[1.0, 0.2, 0.0]]))


def test_brown_camera_equals_perspective_where_they_meet(tmp_path):
    write_opensfm(tmp_path)
    K = load_opensfm(tmp_path).photos[0].camera.K
    for file in tmp_path.glob("*.json"):
        file.unlink()
    values = {"projection_type": "brown", "focal_x": FOCAL, "focal_y": FOCAL, "c_x": 0.0, "c_y": 0.0}
    write_opensfm(tmp_path, **values)
    torch.testing.assert_close(load_opensfm(tmp_path).photos[0].camera.K, K)


def test_axis_angle():
    quarter = rotation_from_axis_angle(torch.tensor([0.0, 0.0, torch.pi / 2]))
    torch.testing.assert_close(quarter, torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    torch.testing.assert_close(rotation_from_axis_angle(torch.zeros(3)), torch.eye(3))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c[0]["cameras"]["phone"].update(focal=0.0), "camera phone.*focal length 0"),
        (lambda c: c[0]["cameras"]["phone"].update(projection_type="spherical"), "spherical"),
        (lambda c: c[0]["cameras"]["phone"].update(width=HEIGHT), "but its camera is 48x48"),
        (lambda c: c[0]["shots"]["view_02.png"].update(rotation=[0, float("nan"), 0]), "view_02.*NaN"),
        (lambda c: c[0]["shots"]["view_02.png"].update(translation=[1, 2]), "view_02.*translation"),
        (lambda c: c[0]["shots"]["view_02.png"].update(camera="lost"), "view_02.*'lost'"),
        (lambda c: c[0]["shots"].pop("view_02.png"), r"1 photos without a camera: view_02\.png"),
        (lambda c: c[0]["shots"].update({"x.png": {}}), r"1 shots without a photo: x\.png"),
        (lambda c: c.clear(), "has 0 reconstructions"),
        (lambda c: c[0].update(points={"1": {}}), "malformed points"),
    ],
)
def test_unusable_values_are_named(tmp_path, change, message):
    content = write_opensfm(tmp_path)
    change(content)
    (tmp_path / "reconstruction.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=message):
        load_opensfm(tmp_path)


def test_points_beyond_single_precision_are_refused_without_a_warning(tmp_path):
    content = write_opensfm(tmp_path)
    content[0]["points"]["7"]["coordinates"][0] = 1e300
    (tmp_path / "reconstruction.json").write_text(json.dumps(content))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match="1 of 1 points that are not finite or too far away"):
            load_opensfm(tmp_path)


def test_drop(tmp_path):
    write_opensfm(tmp_path)
    (tmp_path / "images/view_00.png").unlink()
    assert len(load_opensfm(tmp_path, missing="drop").photos) == COUNT - 1


@pytest.mark.parametrize("part", ["cameras", "shots", "points"])
@pytest.mark.parametrize("value", [[1], 5, "abc"])
def test_parts_that_are_no_objects_are_refused(tmp_path, part, value):
    content = write_opensfm(tmp_path)
    content[0][part] = value
    (tmp_path / "reconstruction.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=f"has {part} = "):
        load_opensfm(tmp_path)


@pytest.mark.parametrize("part", ["cameras", "shots"])
def test_parts_that_are_null_are_refused(tmp_path, part):
    content = write_opensfm(tmp_path)
    content[0][part] = None
    (tmp_path / "reconstruction.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=f"has {part} = None"):
        load_opensfm(tmp_path)
