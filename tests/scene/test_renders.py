import json
import pickle
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.cameras import write_scene_cameras
from gaussian_enhancer.scene.colmap import load_colmap
from gaussian_enhancer.scene.renders import read_folder, read_run, run_steps
from support.captures_on_disk import COUNT, HEIGHT, WIDTH, save, write_colmap


def level(value):
    return np.full((HEIGHT, WIDTH), value)


@pytest.fixture
def scene(tmp_path):
    write_colmap(tmp_path / "ring")
    return load_colmap(tmp_path / "ring")


def write_ours(root, scene, steps=(300, 1000)):
    """Our run folder; a render's grey level tells its step, a depth's value its photo."""
    root.mkdir()
    write_scene_cameras(root / "cameras.json", scene)
    for side, indices in (("train", scene.train), ("test", scene.test)):
        for step in steps:
            for i in indices:
                stem, folder = scene.photos[i].name.removesuffix(".png"), root / side / f"ours_{step}"
                save(folder / "renders" / f"{stem}.png", level(step / 2000))
                save(folder / "gt" / f"{stem}.png", level(i / 10))
                save(folder / "alpha" / f"{stem}.png", level(0.8))
                (folder / "depth").mkdir(exist_ok=True)
                np.save(folder / "depth" / f"{stem}.npy", level(i + 1).astype(np.float32))


def write_3dgs(root, scene, train=True):
    """The original output: renders numbered in camera order, cameras without split or principal point."""
    root.mkdir()
    write_scene_cameras(root / "cameras.json", scene)
    entries = json.loads((root / "cameras.json").read_text())
    for entry in entries:
        for key in ("cx", "cy", "split"):
            del entry[key]
    (root / "cameras.json").write_text(json.dumps(entries))
    for side, indices in (("train", scene.train), ("test", scene.test)):
        for number, i in enumerate(indices):
            if side == "test" or train:
                save(root / side / "ours_7000/renders" / f"{number:05d}.png", level(0.4))
                save(root / side / "ours_7000/gt" / f"{number:05d}.png", level(i / 10))


def test_our_run(tmp_path, scene):
    write_ours(tmp_path / "run", scene)
    found = read_run(tmp_path / "run")
    assert run_steps(tmp_path / "run") == (300, 1000)
    assert [v.name for v in found.targets] == ["view_00.png", "view_08.png"]
    assert len(found.references) == COUNT - 2
    for view in (*found.targets, *found.references):
        i = int(view.name[5:7])
        assert view.read().mean() == pytest.approx(0.5, abs=0.01)
        assert view.read_photo().mean() == pytest.approx(i / 10, abs=0.01)
        assert view.read_depth().unique().tolist() == [i + 1]
        assert view.read_alpha().shape == (1, HEIGHT, WIDTH)
        assert view.read_alpha().mean() == pytest.approx(0.8)
        torch.testing.assert_close(view.camera.world_to_camera, scene.photos[i].camera.world_to_camera)
        torch.testing.assert_close(view.camera.K, scene.photos[i].camera.K)
    assert read_run(tmp_path / "run", 300).targets[0].read().mean() == pytest.approx(0.15, abs=0.01)


def test_only_a_finished_run_of_our_own_jobs_vouches_for_its_depth(tmp_path, scene):
    write_ours(tmp_path / "run", scene)
    assert not read_run(tmp_path / "run").own_depth
    (tmp_path / "run" / "done").write_text("{}")
    assert not read_run(tmp_path / "run").own_depth
    (tmp_path / "run" / "config.yaml").write_text("{}")
    assert read_run(tmp_path / "run").own_depth


def test_original_3dgs_output(tmp_path, scene):
    write_3dgs(tmp_path / "run", scene)
    (tmp_path / "run/cfg_args").write_text("Namespace(sh_degree=3, white_background=True)")
    found = read_run(tmp_path / "run")
    assert found.background == (1.0, 1.0, 1.0)
    assert [v.name for v in found.targets] == ["00000.png", "00001.png"]
    for view, photo in zip(found.targets + found.references, scene.test_photos + scene.train_photos, strict=True):
        torch.testing.assert_close(view.camera.world_to_camera, photo.camera.world_to_camera)
        assert view.read_depth is None
        assert view.read_photo().mean() == pytest.approx(int(photo.name[5:7]) / 10, abs=0.01)


def test_run_without_training_views_takes_the_captures_photos(tmp_path, scene):
    write_3dgs(tmp_path / "run", scene, train=False)
    assert read_run(tmp_path / "run").references == ()
    found = read_run(tmp_path / "run", capture=scene)
    assert [v.name for v in found.references] == [p.name for p in scene.train_photos]
    torch.testing.assert_close(found.targets[1].camera.world_to_camera, scene.photos[8].camera.world_to_camera)


def test_renders_smaller_than_listed_cameras_get_matching_intrinsics(tmp_path, scene):
    write_3dgs(tmp_path / "run", scene)
    for file in (tmp_path / "run").rglob("*.png"):
        save(file, np.zeros((HEIGHT // 2, WIDTH // 2)))
    camera = read_run(tmp_path / "run").targets[0].camera
    assert (camera.height, camera.width) == (HEIGHT // 2, WIDTH // 2)
    assert camera.K[0, 0] == pytest.approx(float(scene.photos[0].camera.K[0, 0]) / 2)


def test_sets_can_be_pickled_for_workers(tmp_path, scene):
    write_ours(tmp_path / "run", scene)
    found = read_run(tmp_path / "run")
    again = pickle.loads(pickle.dumps(found))
    torch.testing.assert_close(again.targets[0].read_depth(), found.targets[0].read_depth())


def run_path(part, name="view_08.png", step=1000):
    return f"test/ours_{step}/{part}/{name}"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda run: save(run / run_path("gt"), np.zeros((HEIGHT, 10))), r"gt/view_08\.png.*10x48.*64x48"),
        (lambda run: save(run / run_path("alpha"), np.zeros((10, WIDTH))), r"alpha/view_08\.png.*64x10"),
        (lambda run: np.save(run / run_path("depth", "view_08.npy"), np.zeros((9, 9))), r"view_08\.npy.*9x9"),
        (lambda run: (run / run_path("depth", "view_08.npy")).unlink(), r"no depth for view_08\.png"),
        (lambda run: (run / run_path("gt")).unlink(), r"no photo for the render view_08\.png"),
        (lambda run: (run / run_path("alpha")).unlink(), r"alpha/view_08\.png.*does not exist"),
        (lambda run: (run / run_path("renders")).write_bytes(b""), r"view_08\.png.*empty"),
        (lambda run: save(run / run_path("renders", "new.png"), level(0)), "'?new'?"),
        (lambda run: (run / "cameras.json").write_text("[\n{]"), "line 2"),
    ],
)
def test_damaged_runs_are_named(tmp_path, scene, change, message):
    write_ours(tmp_path / "run", scene)
    change(tmp_path / "run")
    with pytest.raises(InputError, match=message):
        read_run(tmp_path / "run")


def test_steps_and_folders_that_are_not_there_are_refused(tmp_path, scene):
    write_ours(tmp_path / "run", scene)
    with pytest.raises(InputError, match=r"step 7.*300, 1000"):
        read_run(tmp_path / "run", 7)
    with pytest.raises(InputError, match="holds no test"):
        read_run(tmp_path / "ring")
    with pytest.raises(InputError, match="is no folder"):
        read_run(tmp_path / "none")


def test_cameras_of_another_run_are_refused(tmp_path, scene):
    write_3dgs(tmp_path / "run", scene)
    entries = json.loads((tmp_path / "run/cameras.json").read_text())
    (tmp_path / "run/cameras.json").write_text(json.dumps(entries[:-1]))
    with pytest.raises(InputError, match="8 cameras for 2 test and 7 train"):
        read_run(tmp_path / "run")


def write_bare(root, count=3):
    for i in range(count):
        save(root / "renders" / f"r_{i}.png", level(0.5))
    for i in range(count + 2):
        save(root / "photos" / f"r_{i}.jpg", level(i / 10))


def test_bare_renders_with_the_captures_photos(tmp_path):
    write_bare(tmp_path)
    found = read_folder(tmp_path / "renders", tmp_path / "photos")
    assert [v.name for v in found.targets] == ["r_0.png", "r_1.png", "r_2.png"]
    assert [v.name for v in found.references] == ["r_3.jpg", "r_4.jpg"]
    assert found.targets[2].read_photo().mean() == pytest.approx(0.2, abs=0.01)
    assert found.references[1].read_photo().mean() == pytest.approx(0.4, abs=0.01)
    assert found.targets[0].camera is None
    assert found.targets[0].read_depth is None


def test_bare_renders_with_references_of_their_own_and_no_truth(tmp_path):
    write_bare(tmp_path)
    found = read_folder(tmp_path / "renders", references=tmp_path / "photos")
    assert len(found.references) == 5
    assert all(v.read_photo is None for v in found.targets)


@pytest.mark.parametrize(("factor", "fine"), [(1, False), (2, True)])
def test_photos_of_references_are_fine_photos_only_if_one_is_larger_than_the_renders(tmp_path, factor, fine):
    write_bare(tmp_path)
    save(tmp_path / "photos/r_4.jpg", np.full((factor * HEIGHT, factor * WIDTH), 0.4))
    found = read_folder(tmp_path / "renders", tmp_path / "photos", finer=True)
    assert [view.read_fine_photo is not None for view in found.references] == [fine, fine]


@pytest.mark.parametrize("factor", [1, 4])
def test_a_captures_photos_count_as_larger_by_their_cameras_whatever_reads_them(tmp_path, scene, factor):
    write_bare(tmp_path)
    photos = tuple(
        replace(photo, camera=photo.camera.resized(factor * HEIGHT, factor * WIDTH), read=lambda: torch.zeros(3, 4, 4))
        for photo in scene.photos
    )
    found = read_folder(tmp_path / "renders", references=replace(scene, photos=photos), finer=True)
    assert {view.read_fine_photo is not None for view in found.references} == {factor == 4}


def test_bare_renders_with_depth_and_cameras(tmp_path, scene):
    write_scene_cameras(tmp_path / "cameras.json", scene)
    (tmp_path / "depth").mkdir()
    for i in scene.test:
        save(tmp_path / "renders" / scene.photos[i].name, level(0.5))
        Image.fromarray(level(2000 + i).astype(np.uint16)).save(tmp_path / "depth" / scene.photos[i].name)
    found = read_folder(
        tmp_path / "renders",
        tmp_path / "ring/images",
        depth=tmp_path / "depth",
        cameras=tmp_path / "cameras.json",
        depth_scale=0.001,
    )
    assert len(found.references) == COUNT - 2
    assert found.targets[1].read_depth().mean() == pytest.approx(2.008)
    torch.testing.assert_close(found.targets[1].camera.K, scene.photos[8].camera.K)
    torch.testing.assert_close(found.references[0].camera.K, scene.photos[1].camera.K)
    assert found.references[0].read_depth is None
    (tmp_path / "depth/view_08.png").unlink()
    with pytest.raises(InputError, match=r"no depth for view_08\.png"):
        read_folder(tmp_path / "renders", tmp_path / "ring/images", depth=tmp_path / "depth")


def test_capture_as_references_brings_its_cameras(tmp_path, scene):
    write_bare(tmp_path)
    found = read_folder(tmp_path / "renders", references=scene)
    assert [v.name for v in found.references] == [p.name for p in scene.train_photos]
    assert found.references[0].camera is scene.train_photos[0].camera


def test_transparent_renders_bring_their_alpha(tmp_path):
    write_bare(tmp_path)
    pixels = np.full((HEIGHT, WIDTH, 4), 255, np.uint8)
    pixels[:10, :, 3] = 0
    Image.fromarray(pixels).save(tmp_path / "renders/r_0.png")
    target = read_folder(tmp_path / "renders", tmp_path / "photos").targets[0]
    assert target.read()[:, :10].max() == 0
    assert target.read_alpha().mean() == pytest.approx(1 - 10 / HEIGHT)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda root: save(root / "photos/r_1.jpg", np.zeros((9, 9))), r"r_1\.jpg.*9x9.*r_1\.png is 64x48"),
        (lambda root: [p.unlink() for p in (root / "photos").glob("r_[34].jpg")], "no photo to refer to"),
        (lambda root: save(root / "renders/r_0.jpg", level(0)), r"r_0\.png.*name of r_0\.jpg"),
        (lambda root: [p.unlink() for p in (root / "renders").iterdir()], "holds no image"),
        (lambda root: (root / "renders/r_2.png").write_bytes(b"x"), r"r_2\.png.*is no image"),
    ],
)
def test_unusable_bare_folders_are_named(tmp_path, change, message):
    write_bare(tmp_path)
    change(tmp_path)
    with pytest.raises(InputError, match=message):
        read_folder(tmp_path / "renders", tmp_path / "photos")


def test_the_pair_of_folders_that_3dgs_writes_refers_to_its_runs_training_views(tmp_path, scene):
    write_3dgs(tmp_path / "run", scene)
    pair = tmp_path / "run/test/ours_7000"
    found, run = read_folder(pair / "renders", pair / "gt"), read_run(tmp_path / "run", 7000)
    assert [v.name for v in found.targets] == [v.name for v in run.targets]
    assert len(found.references) == len(scene.train)
    for pair_view, run_view in zip(found.references, run.references, strict=True):
        assert torch.equal(pair_view.camera.world_to_camera, run_view.camera.world_to_camera)
        assert torch.equal(pair_view.read_photo(), run_view.read_photo())


def test_the_pair_of_folders_of_a_run_takes_depth_and_photos_that_are_given(tmp_path, scene):
    write_3dgs(tmp_path / "run", scene)
    pair, depth = tmp_path / "run/test/ours_7000", tmp_path / "depth"
    depth.mkdir()
    for name in ("00000", "00001", "train_00002"):
        np.save(depth / f"{name}.npy", level(3).astype(np.float32))
    for name in ("00000", "00001"):
        save(tmp_path / "fine" / f"{name}.png", np.zeros((4 * HEIGHT, 4 * WIDTH)))
    found = read_folder(pair / "renders", tmp_path / "fine", depth=depth, depth_scale=2.0, finer=True)
    assert [view.read_depth().unique().tolist() for view in found.targets] == [[6.0], [6.0]]
    assert [view.read_depth is not None for view in found.references] == [i == 2 for i in range(len(scene.train))]
    assert all(view.read_fine_photo is not None for view in found.targets)
    for view, photo in zip(found.targets, scene.test_photos, strict=True):
        torch.testing.assert_close(view.camera.world_to_camera, photo.camera.world_to_camera)
    (depth / "00001.npy").unlink()
    with pytest.raises(InputError, match=r"no depth for 00001\.png"):
        read_folder(pair / "renders", pair / "gt", depth=depth)


def test_the_pair_of_folders_of_a_run_takes_cameras_that_are_given(tmp_path, scene):
    write_ours(tmp_path / "run", scene)
    pair, entries = tmp_path / "run/test/ours_1000", json.loads((tmp_path / "run/cameras.json").read_text())
    for entry in entries:
        entry.update(width=2 * WIDTH, height=2 * HEIGHT, fx=777.0, position=[1.0, 2.0, 3.0])
    (tmp_path / "mine.json").write_text(json.dumps(entries))
    found = read_folder(pair / "renders", pair / "gt", cameras=tmp_path / "mine.json")
    assert not found.own_depth  # it may lie in another world than the cameras
    for view in (*found.targets, *found.references):
        assert view.camera.K[0, 0] == 777.0 / 2
        assert view.camera.centre.tolist() == pytest.approx([1.0, 2.0, 3.0])
        assert view.read_depth().unique().tolist() == [int(view.name[5:7]) + 1]
    (tmp_path / "mine.json").write_text(json.dumps(entries[:-1]))
    with pytest.raises(InputError, match=rf"names no camera for {entries[-1]['img_name']}"):
        read_folder(pair / "renders", pair / "gt", cameras=tmp_path / "mine.json")


def test_the_pair_of_folders_of_an_own_run_vouches_for_the_runs_own_depth_alone(tmp_path, scene):
    write_ours(tmp_path / "run", scene)
    for name in ("config.yaml", "done"):
        (tmp_path / "run" / name).write_text("{}")
    pair, copy = tmp_path / "run/test/ours_1000", tmp_path / "copy"
    shutil.copytree(pair / "depth", copy)
    given = [{}, {"depth": pair / "depth"}, {"depth": pair / "depth", "depth_scale": 2.0}, {"depth": copy}]
    given.append({"cameras": tmp_path / "run/cameras.json"})
    assert [read_folder(pair / "renders", pair / "gt", **options).own_depth for options in given] == [
        True,
        True,
        False,
        False,
        False,
    ]


def test_views_that_3dgs_numbers_on_both_sides_are_told_apart(tmp_path, scene):
    write_3dgs(tmp_path / "run", scene)
    found = read_run(tmp_path / "run")
    assert [v.name for v in found.references] == [f"train_{i:05d}.png" for i in range(len(scene.train))]
    assert not {v.name for v in found.references} & {v.name for v in found.targets}


def test_a_run_of_3dgs_without_training_views_says_what_to_give(tmp_path, scene):
    write_3dgs(tmp_path / "run", scene, train=False)
    (tmp_path / "run/cfg_args").write_text("Namespace(sh_degree=3, source_path='/data/garden')")
    pair = tmp_path / "run/test/ours_7000"
    with pytest.raises(InputError, match=r"scene=capture scene\.path=/data/garden"):
        read_folder(pair / "renders", pair / "gt")


@pytest.mark.parametrize("arguments", [True, False])
def test_a_run_of_3dgs_without_renders_says_how_to_give_its_splat(tmp_path, arguments):
    run = tmp_path / "run"
    (run / "point_cloud/iteration_7000").mkdir(parents=True)
    if arguments:
        (run / "cfg_args").write_text("Namespace(sh_degree=3, source_path='/data/garden')")
    capture = "/data/garden" if arguments else "CAPTURE"
    with pytest.raises(InputError, match=rf"gaussians={run} scene=capture scene\.path={capture}"):
        read_run(run)


def test_renders_alone_have_nothing_to_refer_to(tmp_path):
    write_bare(tmp_path)
    with pytest.raises(InputError, match="comes without photos"):
        read_folder(tmp_path / "renders")


def test_views_missing_from_the_cameras_are_named(tmp_path, scene):
    write_bare(tmp_path)
    write_scene_cameras(tmp_path / "cameras.json", scene)
    with pytest.raises(InputError, match=r"no camera for r_0\.png"):
        read_folder(tmp_path / "renders", tmp_path / "photos", cameras=tmp_path / "cameras.json")
