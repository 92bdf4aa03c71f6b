import json

import pytest

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.capture import open_capture
from gaussian_enhancer.scene.splits import Split
from support.captures_on_disk import write_colmap, write_photos, write_transforms


def test_colmap_is_recognised(tmp_path):
    write_colmap(tmp_path)
    scene = open_capture(str(tmp_path), downscale=2, split=Split(3), name="ring")
    assert scene.name == "ring"
    assert scene.test == (0, 3, 6)
    assert scene.photos[0].camera.width == 32
    assert scene.background == (0.0, 0.0, 0.0)


def test_transforms_come_before_colmap(tmp_path):
    write_colmap(tmp_path)
    write_transforms(tmp_path)
    assert open_capture(tmp_path, background=(1.0, 1.0, 1.0)).points is None


def test_nerf_synthetic_keeps_its_white(tmp_path):
    content = write_transforms(tmp_path)
    for side, part in (("train", slice(0, 5)), ("test", slice(5, 9))):
        frames = content["frames"][part]
        (tmp_path / f"transforms_{side}.json").write_text(json.dumps({**content, "frames": frames}))
    scene = open_capture(tmp_path)
    assert scene.background == (1.0, 1.0, 1.0)
    assert len(scene.test) == 4


def test_unknown_layouts_get_one_clear_error(tmp_path):
    with pytest.raises(InputError, match=r"no capture .*nothing.*COLMAP.*transforms\.json.*OpenSfM"):
        open_capture(tmp_path)
    write_photos(tmp_path / "images")
    with pytest.raises(InputError, match=r"holds images"):
        open_capture(tmp_path)
    with pytest.raises(InputError, match="is no folder"):
        open_capture(tmp_path / "none")
