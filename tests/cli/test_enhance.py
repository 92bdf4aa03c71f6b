import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.cli.enhance import naming_configuration, run
from gaussian_enhancer.cli.options import check_options
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.plan import Rules
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.metrics.image_folders import pair_run
from gaussian_enhancer.metrics.records import read_records
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.network.ssif_sr import SSIFSR
from gaussian_enhancer.runs.inputs import InputPaths, refuse_input_folder
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.photos import read_photo
from gaussian_enhancer.scene.posed import ReadPhoto
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.renders import OWN_RUN_FILES, read_run
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.splat.io.ply import write_ply
from gaussian_enhancer.types import Gaussians, quantise_8_bit
from support.bright_weights import bright_network
from support.failures import interrupt
from support.job_config import job_config
from support.synthetic_runs import copy_with_black_photos, plane_camera, write_plane_run
from support.textured_corner import write_corner


def configured(*overrides: str):
    return job_config("enhance", *overrides, "runtime.progress=false", "runtime.threads=1")


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> Path:
    """An untrained network, which returns the render."""
    path = tmp_path_factory.mktemp("weights") / "identity.safetensors"
    save_weights(path, SIF((8, 8, 8), (1, 1, 1)), ReferenceConfig(), {})
    return path


def same(folder: Path, renders: Path) -> bool:
    names = sorted(path.name for path in renders.iterdir())
    assert names == sorted(path.name for path in folder.iterdir())
    return all(torch.equal(read_photo(folder / name), read_photo(renders / name)) for name in names)


def test_a_run_is_enhanced_into_a_run_that_can_be_measured(plane_run, weights, tmp_path):
    milliseconds = run(configured(f"run={plane_run}", f"weights={weights}", f"runs={tmp_path}"))
    assert milliseconds is not None
    (folder,) = (tmp_path / "enhance").iterdir()
    assert (folder / "done").is_file()
    side = folder / "test/ours_100"
    assert same(side / "enhanced", plane_run / "test/ours_100/renders")
    assert same(side / "renders", plane_run / "test/ours_100/renders")
    assert same(side / "gt", plane_run / "test/ours_100/gt")
    records = read_records(folder / "records.jsonl")
    assert {record.view for record in records} == {"view_000.png", "view_004.png"}
    assert all(record.kind == "cost" and record.variant == "enhanced" for record in records)


def test_a_run_that_is_enhanced_again_and_stopped_is_not_done(plane_run, weights, tmp_path, monkeypatch):
    from gaussian_enhancer.cli import enhance

    options = (f"run={plane_run}", f"weights={weights}", f"runs={tmp_path}")
    run(configured(*options))
    with monkeypatch.context() as patched:
        patched.setattr(enhance, "write_enhanced", interrupt)
        with pytest.raises(KeyboardInterrupt):
            run(configured(*options))
    (folder,) = (tmp_path / "enhance").iterdir()
    assert not (folder / "done").is_file()
    run(configured(*options))
    assert (folder / "done").is_file()


def test_views_that_the_input_no_longer_holds_leave_the_run(plane_run, weights, tmp_path):
    side, both, last = plane_run / "test/ours_100", ["view_000.png", "view_004.png"], ["view_004.png"]
    for part in ("renders", "gt"):
        shutil.copytree(side / part, tmp_path / part)
    words = [f"renders={tmp_path / 'renders'}", f"photos={tmp_path / 'gt'}", "max_references=0", f"weights={weights}"]
    words += [f"references={plane_run / 'train/ours_100/gt'}", f"runs={tmp_path}"]
    for removed, renders, photos in ((None, both, both), ("gt", both, last), ("renders", last, last)):
        if removed:
            (tmp_path / removed / "view_000.png").unlink()
        run(configured(*words))
        (folder,) = (tmp_path / "enhance").iterdir()
        for part, names in (("renders", renders), ("enhanced", renders), ("gt", photos)):
            assert sorted(path.name for path in folder.glob(f"test/*/{part}/*")) == names


def test_a_weights_file_with_new_content_leads_to_another_run(weights, tmp_path):
    path = tmp_path / "mine.safetensors"
    path.write_bytes(weights.read_bytes())
    options = configured(f"weights={path}")
    before = naming_configuration(options)
    assert naming_configuration(options) == before
    save_weights(path, SIF((8, 8, 8), (1, 1, 1)), ReferenceConfig(references=1), {})
    assert naming_configuration(options) != before


def test_frames_of_a_path_are_enhanced_by_one_process(plane_run, tmp_path):
    with pytest.raises(InputError, match="by one process"):
        run(
            configured(
                f"run={plane_run}", "temporal_smoothing=0.5", "runtime.processes=2", f"output={tmp_path / 'none'}"
            )
        )
    run(configured(f"run={plane_run}", "temporal_smoothing=0.5", "weights=lr_tiny", f"output={tmp_path / 'path'}"))
    run(configured(f"run={plane_run}", "weights=lr_tiny", f"output={tmp_path / 'each'}"))
    names = sorted(path.name for path in (tmp_path / "path").iterdir())
    same = [(tmp_path / "path" / name).read_bytes() == (tmp_path / "each" / name).read_bytes() for name in names]
    assert same == [True, False]


def test_strength_is_the_cards_unless_it_is_asked_for(plane_run, tmp_path):
    save_weights(tmp_path / "a.safetensors", bright_network(0.2), ReferenceConfig(), {"strength": 0})
    options = [f"run={plane_run}", f"weights={tmp_path / 'a.safetensors'}"]
    run(configured(*options, f"output={tmp_path / 'card'}"))
    assert same(tmp_path / "card", plane_run / "test/ours_100/renders")
    run(configured(*options, "strength=1", f"output={tmp_path / 'full'}"))
    assert not same(tmp_path / "full", plane_run / "test/ours_100/renders")


def test_every_nth_view_is_enhanced_where_a_run_holds_many(plane_run, weights, tmp_path):
    run(configured(f"run={plane_run}", "every=2", f"weights={weights}", f"output={tmp_path / 'out'}"))
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["view_000.png"]
    with pytest.raises(InputError, match="every"):
        check_options("enhance", configured("every=0"))


def test_an_older_snapshot_and_a_folder_of_ones_own(plane_run, weights, tmp_path):
    run(configured(f"run={plane_run}", "step=50", f"weights={weights}", f"output={tmp_path / 'out'}"))
    assert same(tmp_path / "out", plane_run / "test/ours_50/renders")


def test_a_folder_of_renders_with_photos_with_and_without_geometry(plane_run, weights, tmp_path, capsys):
    side, photos = plane_run / "test/ours_100", plane_run / "train/ours_100/gt"
    folders = [f"renders={side / 'renders'}", f"photos={photos}", f"weights={weights}"]
    run(configured(*folders, "recover_geometry=false", f"output={tmp_path / 'bare'}"))
    assert "cannot be reprojected" in capsys.readouterr().err.replace("\n", " ")
    run(
        configured(
            *folders, f"depth={side / 'depth'}", f"cameras={plane_run / 'cameras.json'}", f"output={tmp_path / 'b'}"
        )
    )
    assert "cannot be reprojected" not in capsys.readouterr().err.replace("\n", " ")
    assert same(tmp_path / "bare", side / "renders")
    assert same(tmp_path / "b", side / "renders")


def equal_files(folder: Path, renders: Path) -> bool:
    names = sorted(path.name for path in renders.iterdir())
    assert names == sorted(path.name for path in folder.iterdir() if path.is_file())
    return all((folder / name).read_bytes() == (renders / name).read_bytes() for name in names)


def warned(capsys) -> str:
    """What standard error says in its warning."""
    stderr = capsys.readouterr().err.replace("\n", " ")
    assert stderr.count("WARNING") == 1
    return stderr.split("WARNING: ")[1]


def test_a_run_whose_cameras_are_missing_is_passed_through_bit_for_bit(plane_run, bright, tmp_path, capsys):
    lost = tmp_path / "lost"
    shutil.copytree(plane_run, lost)
    (lost / "cameras.json").unlink()
    run(configured(f"run={lost}", f"weights={bright}", "recover_geometry=false", f"output={tmp_path / 'out'}"))
    assert "has no camera or no depth" in warned(capsys)
    assert equal_files(tmp_path / "out", lost / "test/ours_100/renders")
    run(configured(f"run={plane_run}", f"weights={bright}", f"output={tmp_path / 'known'}"))
    assert not equal_files(tmp_path / "known", plane_run / "test/ours_100/renders")


def test_a_reference_without_a_camera_is_left_out_and_named(plane_run, bright, tmp_path, capsys):
    side, photos = plane_run / "test/ours_100", plane_run / "train/ours_100/gt"
    entries = json.loads((plane_run / "cameras.json").read_text())
    (tmp_path / "few.json").write_text(json.dumps(entries[:-1]))
    folders = [f"renders={side / 'renders'}", f"photos={photos}", f"depth={side / 'depth'}", f"weights={bright}"]
    run(configured(*folders, f"cameras={tmp_path / 'few.json'}", f"output={tmp_path / 'out'}"))
    assert f"1 without a camera left out, {entries[-1]['img_name']}" in capsys.readouterr().err.replace("\n", " ")
    assert not equal_files(tmp_path / "out", side / "renders")


def test_depth_that_one_photo_cannot_give_is_said_so(plane_run, bright, tmp_path, capsys):
    side, photos = plane_run / "test/ours_100", tmp_path / "photos"
    photos.mkdir()
    shutil.copy(next((plane_run / "train/ours_100/gt").iterdir()), photos)
    folders = [f"renders={side / 'renders'}", f"photos={photos}", f"cameras={plane_run / 'cameras.json'}"]
    run(configured(*folders, f"weights={bright}", f"output={tmp_path / 'out'}"))
    assert "depth is recovered from at least 2 photos with cameras" in warned(capsys)


def test_a_splat_unlike_its_photos_is_enhanced_with_a_warning(plane_run, bright, tmp_path, capsys):
    other = copy_with_black_photos(plane_run, tmp_path / "other")
    run(configured(f"run={plane_run}", f"weights={bright}", f"output={tmp_path / 'out'}"))
    assert "WARNING" not in capsys.readouterr().err
    run(configured(f"run={other}", f"weights={bright}", f"output={tmp_path / 'out'}"))
    assert "renders are unlike their photos (median PSNR" in warned(capsys)


def test_renders_that_no_camera_is_found_for_are_passed_through_as_they_are_stored(bright, tmp_path, capsys):
    generator = torch.Generator().manual_seed(0)
    (tmp_path / "renders").mkdir()
    for name in ("renders/a.jpg", "renders/b.png", "photos/c.png", "photos/d.png"):
        write_image(tmp_path / name, torch.rand(3, 48, 64, generator=generator))
    folders = [f"renders={tmp_path / 'renders'}", f"photos={tmp_path / 'photos'}", f"weights={bright}"]
    for _ in range(2):  # the second call knows that nothing was found
        run(configured(*folders, f"output={tmp_path / 'out'}"))
        assert "of 2 renders and 2 photos found no place that they share" in warned(capsys)
        assert equal_files(tmp_path / "out", tmp_path / "renders")
    assert run(configured(*folders, f"output={tmp_path / 'out'}", "dry_run=true")) is None
    assert "Every render is written unchanged" in warned(capsys)


def test_folders_without_cameras_are_enhanced_and_renders_of_another_place_stay(bright, tmp_path, capsys, monkeypatch):
    write_corner(tmp_path, (2, 4, 6), (6,))
    folders = [f"renders={tmp_path / 'renders'}", f"photos={tmp_path / 'photos'}", f"weights={bright}"]
    run(configured(*folders, f"output={tmp_path / 'out'}"))
    stderr = capsys.readouterr().err.replace("\n", " ")
    assert "structure from motion: 2 of 3 renders, 6 of 6 photos" in stderr
    assert "by plane sweep" in stderr
    assert "WARNING: 1 of 3 renders have no camera or no depth, so that no photo can be used: view_6.png." in stderr
    changed = {
        path.name: path.read_bytes() != (tmp_path / "out" / path.name).read_bytes()
        for path in (tmp_path / "renders").iterdir()
    }
    assert changed == {"view_2.png": True, "view_4.png": True, "view_6.png": False}
    monkeypatch.setattr("gaussian_enhancer.runs.recovered_geometry.reconstruct", None)  # is not called again
    run(configured(*folders, f"output={tmp_path / 'out'}", "plan=full", "temporal_smoothing=0.5"))
    assert "view_6.png" in warned(capsys)
    assert (tmp_path / "out/view_6.png").read_bytes() == (tmp_path / "renders/view_6.png").read_bytes()


def test_recovery_is_part_of_a_runs_address_only_where_folders_are_given(plane_run):
    for override, same_address in ((f"run={plane_run}", True), ("renders=a", False)):
        with_key = naming_configuration(configured(override))
        assert ("recover_geometry" not in with_key) is same_address
        assert with_key != naming_configuration(configured(override, "recover_geometry=false"))


def test_a_splat_is_rendered_with_its_capture(plane_run, weights, tmp_path, monkeypatch):
    generator = torch.Generator().manual_seed(0)
    means = torch.rand(200, 3, generator=generator) * torch.tensor([3.0, 3.0, 0.1]) + torch.tensor([-1.5, -1.5, 3.0])
    gaussians = Gaussians(
        means,
        torch.full((200, 3), -2.0),
        torch.tensor([1.0, 0, 0, 0]).repeat(200, 1),
        torch.full((200,), 3.0),
        torch.rand(200, 1, 3, generator=generator),
    )
    write_ply(tmp_path / "splat.ply", gaussians)
    photos = tuple(
        Photo(view.name, plane_camera(index, 48, 64), view.read_photo)  # type: ignore[arg-type]
        for index, view in enumerate(read_run(plane_run).references)
    )
    capture = Scene("capture", photos, tuple(range(1, len(photos))), (0,))
    monkeypatch.setattr("gaussian_enhancer.runs.inputs.build", lambda node: capture)
    options = ["scene=capture", "scene.path=unused", f"weights={weights}", f"runs={tmp_path}"]
    run(configured(f"gaussians={tmp_path / 'splat.ply'}", *options))
    (folder,) = (tmp_path / "enhance").iterdir()
    assert same(folder / "test/ours_0/enhanced", folder / "test/ours_0/renders")
    assert read_photo(folder / "test/ours_0/renders" / photos[0].name).std() > 0.05
    with pytest.raises(InputError, match="method"):
        run(configured(f"gaussians={tmp_path / 'splat.ply'}", *options, "method=nerf"))
    for name, moved in (("behind", means * torch.tensor([1.0, 1.0, -1.0])), ("beside", means + 50)):
        write_ply(tmp_path / f"{name}.ply", replace(gaussians, means=moved))
        with pytest.raises(InputError, match=r"has no Gaussian in any view of capture.*coordinates of its capture"):
            run(configured(f"gaussians={tmp_path / name}.ply", *options))


def test_input_that_cannot_be_used_is_refused(plane_run, weights, tmp_path):
    photos = plane_run / "train/ours_100/gt"
    for options, words in (
        ([], "nothing to enhance"),
        ([f"run={plane_run}", f"renders={photos}"], "run and renders"),
        (["gaussians=a.ply"], "without its capture"),
        ([f"renders={plane_run / 'test/ours_100/renders'}"], "without photos"),
        ([f"run={plane_run}", "step=7"], "no renders of step 7"),
        ([f"run={plane_run}", "views=all"], "views: was given beside run; leave views out"),
        ([f"run={plane_run}", f"photos={photos}"], "photos: was given beside run"),
        (["gaussians=a.ply", "step=7"], "step: was given beside gaussians"),
        ([f"renders={photos}", "method=3dgs"], "method: was given beside renders"),
        ([f"run={plane_run}", "max_references=9"], "0 to 8"),
    ):
        with pytest.raises(InputError, match=words):
            run(configured(*options, f"weights={weights}", f"runs={tmp_path}"))
    with pytest.raises(InputError, match="neither a file nor a shipped name"):
        run(configured(f"run={plane_run}", "weights=absent", f"runs={tmp_path}"))
    assert not list(tmp_path.iterdir())


def test_a_folder_of_the_input_is_not_written_into(plane_run, weights, tmp_path):
    shutil.copytree(plane_run / "test/ours_100/renders", tmp_path / "renders")
    shutil.copytree(plane_run / "train/ours_100/gt", tmp_path / "photos")
    inputs = (f"renders={tmp_path / 'renders'}", f"photos={tmp_path / 'photos'}", f"weights={weights}")
    before = [path.read_bytes() for path in sorted(tmp_path.glob("*/*"))]
    for folder in ("renders", "photos"):
        for dry_run in ("false", "true"):
            with pytest.raises(InputError, match="of the input; name another folder"):
                run(configured(*inputs, f"output={tmp_path / folder}", f"dry_run={dry_run}"))
    assert [path.read_bytes() for path in sorted(tmp_path.glob("*/*"))] == before


def test_folders_of_an_own_run_have_its_kind_of_depth(plane_run, tmp_path):
    own = shutil.copytree(plane_run, tmp_path / "run")
    side = own / "test/ours_100"
    paths = InputPaths(renders=side / "renders", photos=side / "gt", every=2)
    assert paths.read("cpu", False).depth == "expected"  # of another program
    for name in OWN_RUN_FILES:
        (own / name).write_text("{}")
    task = paths.read("cpu", False)
    assert task.depth == "surface"
    assert [view.name for view in task.rendered.targets] == ["view_000.png"]


def test_a_splats_capture_is_not_written_into():
    photo = Photo("a.jpg", plane_camera(0, 48, 64), ReadPhoto(Path("capture/images/a.jpg"), 48, 64, (0.0, 0.0, 0.0)))
    views = (RenderedView(photo.name, None, photo.camera, read_photo=photo.read),)
    refuse_input_folder(Path("capture"), RenderedSet("s", (), views))
    with pytest.raises(InputError, match=r"holds a.jpg of the input"):
        refuse_input_folder(Path("capture/images"), RenderedSet("s", (), views))


@pytest.fixture(scope="module")
def fine_weights(tmp_path_factory) -> Path:
    """An untrained network, which returns the bicubically enlarged render."""
    path = tmp_path_factory.mktemp("weights") / "fine.safetensors"
    save_weights(path, SSIFSR((8, 8, 8), (1, 1, 1)), ReferenceConfig(fine=True), {})
    return path


def test_a_run_is_enlarged_beside_photos_as_fine(plane_run, fine_weights, tmp_path, monkeypatch):
    finer = read_run(write_plane_run(tmp_path / "fine", size=(192, 256)))
    photos = tuple(Photo(v.name, v.camera, v.read_photo) for v in (*finer.targets, *finer.references))
    scene = Scene("plane", photos, tuple(range(1, 8)), (0,))
    monkeypatch.setattr("gaussian_enhancer.runs.inputs.build", lambda node: scene)
    monkeypatch.setattr("gaussian_enhancer.runs.inputs.high_resolution_config", lambda node: node)
    options = ["scene=capture", "scene.path=unused", f"weights={fine_weights}", f"runs={tmp_path / 'runs'}"]
    run(configured(f"run={plane_run}", *options))
    (folder,) = (tmp_path / "runs/enhance").iterdir()
    side = folder / "test/ours_100"
    assert same(side / "enhanced", side / "renders")
    for view in finer.targets:
        assert torch.equal(read_photo(side / "gt" / view.name), view.read_photo())
    render = read_photo(plane_run / "test/ours_100/renders/view_000.png")
    expected = quantise_8_bit(upsample_bicubic(render[None], 4)[0])
    torch.testing.assert_close(read_photo(side / "renders/view_000.png"), expected)
    files = pair_run(folder, None)
    assert {file.label.variant for file in files} == {"raw", "enhanced"}


def test_without_finer_photos_a_run_is_enlarged_all_the_same_and_told_so(plane_run, fine_weights, tmp_path, capsys):
    run(configured(f"run={plane_run}", f"weights={fine_weights}", f"output={tmp_path / 'out'}", f"runs={tmp_path}"))
    stderr = capsys.readouterr().err.replace("\n", " ")
    assert "config.yaml: does not exist" in stderr
    assert "super-resolution without" in stderr
    assert read_photo(tmp_path / "out/view_000.png").shape == (3, 192, 256)


def test_a_folder_with_photos_finer_than_its_renders(plane_run, fine_weights, weights, tmp_path):
    fine = write_plane_run(tmp_path / "fine", size=(192, 256))
    (tmp_path / "photos").mkdir()
    for path in sorted(fine.glob("t*/ours_100/gt/*.png")):
        (tmp_path / "photos" / path.name).write_bytes(path.read_bytes())
    folders = [f"renders={plane_run / 'test/ours_100/renders'}", f"photos={tmp_path / 'photos'}", f"runs={tmp_path}"]
    geometry = [f"depth={plane_run / 'test/ours_100/depth'}", f"cameras={plane_run / 'cameras.json'}"]
    run(configured(*folders, *geometry, f"weights={fine_weights}"))
    (folder,) = (tmp_path / "enhance").iterdir()
    assert same(folder / "test/ours_0/gt", fine / "test/ours_100/gt")
    assert same(folder / "test/ours_0/enhanced", folder / "test/ours_0/renders")
    run(configured(*folders, *geometry, f"weights={weights}"))  # at the render's size, its own photo is resized
    (other,) = set((tmp_path / "enhance").iterdir()) - {folder}
    assert read_photo(other / "test/ours_0/gt/view_000.png").shape == (3, 48, 64)
    write_image(tmp_path / "photos/view_000.png", torch.zeros(3, 192, 200))
    with pytest.raises(InputError, match="is 200x192 but its render"):
        run(configured(*folders, f"weights={weights}"))


def test_the_plan_is_made_first_printed_and_kept(plane_run, weights, tmp_path, capsys):
    options = [f"run={plane_run}", f"weights={weights}", f"runs={tmp_path}", "max_references=1"]
    assert run(configured(*options, "dry_run=true")) is None
    assert "all are warped: on views of this size" in capsys.readouterr().out
    assert run(configured(*options, "plan.small=0", "dry_run=true")) is None
    printed = capsys.readouterr().out
    assert "references" in printed
    assert "10 examined for 2 views, 8 left out" in printed
    assert not list(tmp_path.iterdir())
    run(configured(*options, "plan.small=0"))
    (folder,) = (tmp_path / "enhance").iterdir()
    plan = json.loads((folder / "plan.json").read_text())
    assert [view["name"] for view in plan["views"]] == ["view_000.png", "view_004.png"]
    assert all(len(view["references"]) == 1 for view in plan["views"])
    assert "10 examined" in capsys.readouterr().err
    run(configured(*options, "plan=full"))
    (full,) = set((tmp_path / "enhance").iterdir()) - {folder}
    plan = json.loads((full / "plan.json").read_text())
    assert plan["views"] == []
    assert Rules(**plan["rules"]).full
    assert same(full / "test/ours_100/enhanced", plane_run / "test/ours_100/renders")


def test_single_items_are_forced(plane_run, weights, tmp_path, capsys):
    options = [f"run={plane_run}", f"weights={weights}", f"runs={tmp_path}", "dry_run=true"]
    run(configured(*options, "plan.references=all"))
    assert "examined" not in capsys.readouterr().out
    run(configured(*options, "plan.depth=none"))
    assert "switched off" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"plan\.tiles"):
        run(configured(*options, "plan.tiles=some"))


def test_what_changes_no_image_is_no_part_of_a_runs_address(plane_run):
    auto, full = configured(f"run={plane_run}"), configured(f"run={plane_run}", "plan=full")
    assert naming_configuration(full) == naming_configuration(
        configured(f"run={plane_run}", "plan=full", "dry_run=true", "temporal_smoothing=0")
    )
    assert naming_configuration(full) != naming_configuration(
        configured(f"run={plane_run}", "plan=full", "temporal_smoothing=0.5")
    )
    assert "plan" not in naming_configuration(full)
    assert naming_configuration(auto) != naming_configuration(full)
    assert naming_configuration(auto) != naming_configuration(configured(f"run={plane_run}", "plan.share=0.2"))
    assert auto.dry_run is False


def test_a_kind_of_depth_that_is_none_is_refused(plane_run, weights, tmp_path):
    with pytest.raises(InputError, match="surface, expected, exact"):
        run(configured(f"run={plane_run}", "depth_kind=mean", f"weights={weights}", f"output={tmp_path / 'out'}"))
