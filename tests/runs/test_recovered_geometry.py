"""Recovered geometry: true up to scale, kept for the next call, and none where there is none."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs import recovered_geometry
from gaussian_enhancer.runs.recovered_geometry import lacks_geometry, recover_geometry
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.scene.renders import read_folder
from gaussian_enhancer.splat.fit import plane_sweep
from support.textured_corner import corner_camera, corner_view, write_corner

RENDERS, STRANGE = (1, 2, 6), 6


@pytest.fixture(scope="module")
def corner(tmp_path_factory) -> Path:
    """Folders of renders, of which one shows another place, and photos; with the geometry that was recovered."""
    root = tmp_path_factory.mktemp("corner")
    write_corner(root, RENDERS, (STRANGE,))
    recover_geometry(read_folder(root / "renders", root / "photos"), root / "geometry")
    return root


def opened(corner: Path) -> RenderedSet:
    return read_folder(corner / "renders", corner / "photos")


def unrepeated(monkeypatch) -> None:
    def called(*arguments: object, **names: object) -> None:
        raise AssertionError("done once more")

    monkeypatch.setattr(recovered_geometry, "reconstruct", called)
    monkeypatch.setattr(plane_sweep, "sweep_depths", called)


def test_depth_is_the_true_one_in_the_cameras_unit(corner, monkeypatch):
    unrepeated(monkeypatch)
    recovered = recover_geometry(opened(corner), corner / "geometry")
    views = {view.name: view for view in (*recovered.rendered.targets, *recovered.rendered.references)}
    centres = [view.camera.centre for view in views.values() if view.camera is not None]
    true = [corner_camera(int(name[5])).centre for name, view in views.items() if view.camera is not None]
    unit = torch.pdist(torch.stack(centres)).sum() / torch.pdist(torch.stack(true)).sum()
    for name in ("view_1.png", "view_2.png", "view_4.png"):
        height, width = views[name].camera.height, views[name].camera.width
        depth = corner_view(corner_camera(int(name[5]), height, width))[1]
        ratio = views[name].read_depth() / (unit * depth)
        assert ratio.shape == (1, height, width)
        assert float(ratio.median()) == pytest.approx(1, abs=0.02)
        assert float((ratio / ratio.median() - 1).abs().quantile(0.8)) < 0.02


def test_a_render_without_a_place_has_neither_camera_nor_depth_and_is_counted(corner):
    recovered = recover_geometry(opened(corner), corner / "geometry")
    strange = recovered.rendered.targets[2]
    assert (strange.name, strange.camera, strange.read_depth) == (f"view_{STRANGE}.png", None, None)
    assert "2 of 3 renders, 6 of 6 photos" in recovered.cameras
    assert "plane sweep" in recovered.depth
    assert str(corner / "geometry") in recovered.depth


def test_other_images_are_recovered_anew(corner, tmp_path, monkeypatch):
    write_corner(tmp_path, RENDERS)
    monkeypatch.setattr(recovered_geometry, "reconstruct", lambda images, folder, progress: False)
    assert "no place that they share" in recover_geometry(opened(tmp_path), corner / "geometry").cameras


def test_where_nothing_is_found_the_set_stays_and_no_second_call_tries(tmp_path, monkeypatch):
    for name in ("renders/a.png", "photos/b.png", "photos/c.png"):
        write_image(tmp_path / name, torch.full((3, 48, 64), 0.5))
    rendered = read_folder(tmp_path / "renders", tmp_path / "photos")
    first = recover_geometry(rendered, tmp_path / "geometry")
    unrepeated(monkeypatch)
    second = recover_geometry(rendered, tmp_path / "geometry")
    assert first.rendered is second.rendered is rendered
    assert first.cameras == second.cameras
    assert "1 renders and 2 photos found no place that they share" in first.cameras
    (folder,) = (tmp_path / "geometry").iterdir()
    assert [path.name for path in folder.iterdir()] == ["geometry.json"]


def test_cameras_that_were_given_stay_and_depth_alone_is_swept(corner, tmp_path, monkeypatch):
    monkeypatch.setattr(recovered_geometry, "reconstruct", None)
    rendered = opened(corner)
    targets = tuple(replace(view, camera=corner_camera(int(view.name[5]))) for view in rendered.targets[:2])
    references = tuple(replace(v, camera=corner_camera(int(v.name[5]), 360, 480)) for v in rendered.references)
    assert lacks_geometry(replace(rendered, targets=targets, references=references))
    recovered = recover_geometry(replace(rendered, targets=targets, references=references), tmp_path)
    assert recovered.cameras == ""
    for view, target in zip(recovered.rendered.targets, targets, strict=True):
        assert view.camera is target.camera
        depth = corner_view(target.camera)[1]
        assert float((view.read_depth() / depth - 1).abs().quantile(0.8)) < 0.02


def test_depth_that_comes_without_cameras_is_left_out_and_said_so(corner):
    rendered = opened(corner)
    targets = tuple(replace(view, read_depth=lambda: torch.ones(1, 180, 240)) for view in rendered.targets)
    assert "given depth is ignored" in recover_geometry(replace(rendered, targets=targets), corner / "geometry").depth


def test_geometry_is_missed_only_where_photos_could_use_it(corner):
    rendered = recover_geometry(opened(corner), corner / "geometry").rendered
    assert lacks_geometry(rendered)
    assert not lacks_geometry(replace(rendered, targets=rendered.targets[:2]))
    assert not lacks_geometry(replace(opened(corner), references=()))
    assert lacks_geometry(opened(corner))


def test_what_a_killed_call_left_is_made_again_and_a_damaged_photo_leaves_nothing(tmp_path):
    write_corner(tmp_path, (2,))
    (tmp_path / "photos/view_0.png").write_bytes((tmp_path / "photos/view_0.png").read_bytes()[:-999])
    with pytest.raises(InputError, match=r"view_0\.png"):
        recover_geometry(opened(tmp_path), tmp_path / "geometry")
    assert not (tmp_path / "geometry").exists()


def test_a_damaged_depth_map_is_named(corner, tmp_path):
    recovered = recover_geometry(opened(corner), corner / "geometry").rendered.targets[0]
    damaged = replace(recovered.read_depth, path=tmp_path / "set/depth/render_00000.npy")
    damaged.path.parent.mkdir(parents=True)
    damaged.path.write_bytes(b"\x93NUMPY")
    with pytest.raises(InputError, match=re.escape(f"delete {tmp_path / 'set'}")):
        damaged()


def test_truths_take_no_part(corner, tmp_path, monkeypatch):
    def unread() -> torch.Tensor:
        raise AssertionError("a truth was read")

    unrepeated(monkeypatch)
    rendered = opened(corner)
    targets = tuple(replace(view, read_photo=unread) for view in rendered.targets)
    recovered = recover_geometry(replace(rendered, targets=targets), corner / "geometry")
    assert [view.read_photo for view in recovered.rendered.targets] == [unread] * 3


def test_the_summary_is_plain(corner):
    (folder,) = [path for path in (corner / "geometry").iterdir() if (path / "depth").is_dir()]
    summary = json.loads((folder / "geometry.json").read_text())
    assert summary["found"] is True
    assert set(summary["seconds"]) == {"cameras", "depth"}
    assert np.load(folder / "depth/render_00000.npy").ndim == 2
