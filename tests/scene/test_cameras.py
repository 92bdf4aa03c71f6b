import json

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.cameras import read_cameras, write_cameras, write_scene_cameras
from gaussian_enhancer.scene.colmap import load_colmap
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.scene.renders import read_folder, read_run
from support.captures_on_disk import write_colmap
from support.synthetic_runs import write_plane_run


@pytest.fixture
def scene(tmp_path):
    write_colmap(tmp_path / "ring")
    return load_colmap(tmp_path / "ring")


def test_cameras_survive_a_round_trip(tmp_path, scene):
    write_scene_cameras(tmp_path / "cameras.json", scene)
    listed = read_cameras(tmp_path / "cameras.json")
    assert [entry.split for entry in listed] == ["test"] * 2 + ["train"] * 7
    for entry, photo in zip(listed, (*scene.test_photos, *scene.train_photos), strict=True):
        assert entry.name == photo.name
        torch.testing.assert_close(entry.camera.K, photo.camera.K)
        torch.testing.assert_close(entry.camera.world_to_camera, photo.camera.world_to_camera)


def test_the_file_means_what_3dgs_means(tmp_path, scene):
    write_scene_cameras(tmp_path / "cameras.json", scene)
    entry, photo = json.loads((tmp_path / "cameras.json").read_text())[0], scene.test_photos[0]
    to_world = torch.linalg.inv(photo.camera.world_to_camera.double())
    torch.testing.assert_close(torch.tensor(entry["position"]), to_world[:3, 3].float())
    torch.testing.assert_close(torch.tensor(entry["rotation"]), to_world[:3, :3].float())
    assert (entry["id"], entry["img_name"], entry["width"], entry["height"]) == (0, photo.name, 64, 48)


def test_3dgs_entries_have_their_principal_point_in_the_middle(tmp_path, scene):
    write_scene_cameras(tmp_path / "cameras.json", scene)
    entries = json.loads((tmp_path / "cameras.json").read_text())
    for entry in entries:
        del entry["cx"], entry["cy"], entry["split"]
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    listed = read_cameras(tmp_path / "cameras.json")[0]
    assert listed.camera.K[:2, 2].tolist() == [32, 24]
    assert listed.split is None


def test_nothing_half_written_stays(tmp_path, scene):
    views = [*scene.photos, RenderedView("bare.png", None)]
    with pytest.raises(InputError, match=r"bare\.png"):
        write_cameras(tmp_path / "cameras.json", views, ["train"] * len(views))
    with pytest.raises(InputError, match="splits"):
        write_cameras(tmp_path / "cameras.json", scene.photos, ["train"])
    assert not list(tmp_path.glob("cameras*"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.clear(), "lists no cameras"),
        (lambda c: c[1].update(fx=0), "entry 1.*focal"),
        (lambda c: c[1].pop("fy"), "entry 1.*fy"),
        (lambda c: c[1].update(width=0), "entry 1.*width = 0"),
        (lambda c: c[1].update(position=[1, 2]), "entry 1.*malformed pose"),
        (lambda c: c[1].update(position=[1, 2, float("nan")]), "entry 1.*NaN"),
        (lambda c: c[1].update(rotation=[[2, 0, 0], [0, 2, 0], [0, 0, 2]]), "entry 1.*scales"),
        (lambda c: c[1].update(split="val"), "entry 1.*'val'"),
    ],
)
def test_unusable_entries_are_named(tmp_path, scene, change, message):
    write_scene_cameras(tmp_path / "cameras.json", scene)
    entries = json.loads((tmp_path / "cameras.json").read_text())
    change(entries)
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    with pytest.raises(InputError, match=message):
        read_cameras(tmp_path / "cameras.json")


@pytest.mark.parametrize(
    ("key", "value"), [("cx", float("inf")), ("cx", 1e30), ("width", float("nan")), ("fx", 1e-300)]
)
def test_values_that_no_camera_has_are_refused(tmp_path, scene, key, value):
    write_scene_cameras(tmp_path / "cameras.json", scene)
    entries = json.loads((tmp_path / "cameras.json").read_text())
    entries[1][key] = value
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    with pytest.raises(InputError, match="entry 1"):
        read_cameras(tmp_path / "cameras.json")


def test_a_camera_for_two_views_is_refused(tmp_path):
    write_plane_run(tmp_path)
    entries = json.loads((tmp_path / "cameras.json").read_text())
    entries.append({**entries[1], "img_name": entries[0]["img_name"]})
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    with pytest.raises(InputError, match=r"cameras\.json: lists 'view_000' more than once"):
        read_run(tmp_path)
    with pytest.raises(InputError, match=r"cameras\.json: lists 'view_000' more than once"):
        read_folder(
            tmp_path / "test/ours_100/renders", tmp_path / "test/ours_100/gt", cameras=tmp_path / "cameras.json"
        )
