"""The job video on a small run of a textured plane, whose splat is a sheet of coloured Gaussians."""

import itertools
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gaussian_enhancer.cli.video import run
from gaussian_enhancer.errors import INTERRUPTED, InputError
from gaussian_enhancer.runs.splat_source import open_splat_with_capture
from gaussian_enhancer.scene.photos import read_photo
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.video.film import Film
from support.clips import decoded, heard, write_clip
from support.job_config import QUIET, job_config
from support.synthetic_runs import copy_with_moved_splat, plane_camera

av = pytest.importorskip("av", reason="PyAV is in the dependency group `test`")
FRAMES = 5
FLIPPED = torch.diag(torch.tensor([1.0, -1, -1, 1]))
"""From a camera of OpenGL to one of OpenCV."""


def configured(*overrides: str):
    return job_config("video", *overrides, *QUIET)


@pytest.fixture
def words(sheet_run, bright, tmp_path) -> tuple[str, ...]:
    return f"run={sheet_run}", f"weights={bright}", f"runs={tmp_path / 'runs'}", f"frames={FRAMES}"


def images(folder: Path) -> dict[str, torch.Tensor]:
    return {path.name: read_photo(path) for path in sorted(folder.iterdir())}


def folder_of(tmp_path: Path) -> Path:
    (folder,) = (tmp_path / "runs" / "video").iterdir()
    return folder


def test_a_run_becomes_a_video_and_another_layout_of_it_makes_no_frame_again(words, tmp_path, monkeypatch):
    run(configured(*words))
    folder = folder_of(tmp_path)
    assert sorted(path.name for path in folder.iterdir()) == ["config.yaml", "done", "enhanced.mp4", "frames"]
    frames = images(folder / "frames")
    assert len(frames) == FRAMES
    shown = decoded(folder / "enhanced.mp4")
    assert len(shown) == FRAMES
    for frame, image in zip(shown, frames.values(), strict=True):
        assert frame.shape == image.shape == (3, 48, 64)
        assert float((frame - image).abs().mean()) < 0.04
    assert min(float((a - b).abs().mean()) for a, b in itertools.pairwise(shown)) > 0

    monkeypatch.setattr(Film, "_enhance", lambda *_: pytest.fail("a frame was made again"))
    run(configured(*words, "layout=side_by_side", f"output={tmp_path / 'beside.webm'}", "fps=10"))
    assert folder_of(tmp_path) == folder
    wide = decoded(tmp_path / "beside.webm")
    assert [frame.shape for frame in wide] == [(3, 48, 128)] * FRAMES
    render, enhanced = wide[2].chunk(2, dim=-1)
    assert float(enhanced.mean()) > float(render.mean()) + 0.02
    assert not list(folder.glob("*.part.*"))


def test_frames_of_a_longer_video_in_the_folder_are_reported(words, tmp_path, capsys):
    longer, output = tmp_path / "frames", f"output={tmp_path / 'frames'}"
    run(configured(*words, "format=frames", "layout=wipe", output))
    assert "WARNING" not in capsys.readouterr().err
    run(configured(*words, "format=frames", "layout=wipe", output, f"frames={FRAMES - 2}"))
    assert "also holds 2 frames of an earlier, longer video" in capsys.readouterr().err.replace("\n", " ")
    assert len(images(longer)) == FRAMES


def test_a_folder_of_frames_and_a_resumed_run_are_as_a_run_in_one_go(words, tmp_path, monkeypatch, capsys):
    run(configured(*words, "format=frames", "layout=wipe", f"output={tmp_path / 'whole'}"))
    whole = images(folder_of(tmp_path) / "frames")
    written = images(tmp_path / "whole")
    assert list(written) == list(whole)
    assert torch.equal(written["frame_000001.png"][..., 34:], whole["frame_000001.png"][..., 34:])
    assert not torch.equal(written["frame_000001.png"][..., :30], whole["frame_000001.png"][..., :30])

    shutil.rmtree(tmp_path / "runs")
    enhanced, count = Film._enhance, 0

    def interrupted(*args):
        nonlocal count
        count += 1
        if count == 3:
            raise KeyboardInterrupt
        return enhanced(*args)

    monkeypatch.setattr(Film, "_enhance", interrupted)
    with pytest.raises(SystemExit) as stop:
        run(configured(*words))
    assert stop.value.code == INTERRUPTED
    assert f"2 of {FRAMES} frames made; the same command resumes" in capsys.readouterr().err
    folder = folder_of(tmp_path)
    assert len(images(folder / "frames")) == 2
    assert len(decoded(folder / "enhanced.part.mp4")) == 2
    assert not (folder / "done").exists()
    run(configured(*words))
    assert count == FRAMES + 1  # the third was begun twice
    resumed = images(folder / "frames")
    assert all(torch.equal(resumed[name], whole[name]) for name in whole)
    assert len(decoded(folder / "enhanced.mp4")) == FRAMES


def test_a_splat_and_its_capture_along_a_path_of_nerfstudio(sheet_run, bright, tmp_path, monkeypatch):
    photos = tuple(
        Photo(view.name, plane_camera(index, 48, 64), view.read_photo)  # type: ignore[arg-type]
        for index, view in enumerate(read_run(sheet_run).references)
    )
    capture = Scene("capture", photos, tuple(range(len(photos))), ())
    monkeypatch.setattr("gaussian_enhancer.runs.splat_source.build", lambda _: capture)
    poses = [torch.linalg.inv(plane_camera(index, 48, 64).world_to_camera) @ FLIPPED for index in range(3)]
    entries = [{"camera_to_world": pose.flatten().tolist(), "fov": 50, "aspect": 1.5} for pose in poses]
    content = {"render_height": 33, "render_width": 40, "fps": 12, "camera_path": entries}
    (tmp_path / "path.json").write_text(json.dumps(content))
    words = f"gaussians={sheet_run / 'splat.ply'}", "scene=capture", "scene.path=x", f"path={tmp_path / 'path.json'}"
    cfg = configured(*words, f"weights={bright}", f"runs={tmp_path / 'runs'}", f"output={tmp_path / 'clip.mp4'}")
    run(cfg)
    assert [frame.shape for frame in decoded(tmp_path / "clip.mp4")] == [(3, 32, 40)] * 3
    with av.open(str(tmp_path / "clip.mp4")) as source:
        assert source.streams.video[0].average_rate == 12
    with pytest.raises(InputError, match="of the input; name another folder"):
        run(configured(*words, f"weights={bright}", "format=frames", f"output={photos[0].read.path.parent}"))
    results = tmp_path / "results"  # as gsplat's simple_trainer leaves it
    (results / "ply").mkdir(parents=True)
    shutil.copyfile(sheet_run / "splat.ply", results / "ply/point_cloud_29999.ply")
    run(configured(f"gaussians={results}", *words[1:], f"weights={bright}", f"runs={tmp_path / 'others'}"))
    frames = [images(folder / "frames") for folder in sorted(tmp_path.glob("*/video/*"))]
    assert [len(one) for one in frames] == [3, 3]
    assert all(torch.equal(image, frames[1][name]) for name, image in frames[0].items())
    assert not list(tmp_path.glob(".*"))


def test_a_splat_outside_the_views_of_its_capture_is_refused(sheet_run, bright, tmp_path):
    moved = copy_with_moved_splat(sheet_run, tmp_path / "moved")
    for job in ("video", "view"):
        cfg = job_config(job, f"run={moved}", f"weights={bright}", *QUIET)
        with pytest.raises(InputError, match=r"splat\.ply: has no Gaussian in any view of moved; give the splat in"):
            open_splat_with_capture(cfg, job).renderer(cfg, "cpu")
    with pytest.raises(InputError, match="has no Gaussian in any view"):
        run(configured(f"run={moved}", f"weights={bright}", f"runs={tmp_path / 'runs'}"))
    assert not (tmp_path / "runs").exists()


def test_references_without_renders_are_rendered_from_the_splat(sheet_run):
    cfg = job_config("video", f"run={sheet_run}", *QUIET)
    opened = open_splat_with_capture(cfg, "video")
    bare = tuple(replace(view, read=None, read_depth=None) for view in opened.rendered.references)
    opened = replace(opened, rendered=replace(opened.rendered, references=bare))
    references = opened.references_rendered_by(opened.renderer(cfg, "cpu")).references
    assert [view.name for view in references] == [view.name for view in bare]
    for view in references:
        assert view.read().shape == view.read_photo().shape
        assert view.read_depth().max() > 0


@pytest.mark.parametrize(
    ("options", "name"),
    [(("turns=3",), "turns"), (("radius=2",), "radius"), (("path=orbit", "cameras=4"), "cameras")],
)
def test_options_of_another_shape_are_refused(words, options, name):
    with pytest.raises(InputError, match=f"{name}: was given beside path="):
        run(configured(*words, *options))


def test_another_path_of_the_same_name_is_another_run(sheet_run, bright, tmp_path):
    words = f"run={sheet_run}", f"weights={bright}", f"runs={tmp_path / 'runs'}", "format=frames"
    for count in (1, 2):
        frames = [
            {"transform_matrix": (torch.linalg.inv(plane_camera(i, 48, 64).world_to_camera)
                                  @ torch.diag(torch.tensor([1.0, -1, -1, 1]))).tolist()}
            for i in range(count)
        ]  # fmt: skip
        content = {"w": 64, "h": 48, "fl_x": 64.0, "frames": frames}
        (tmp_path / "transforms.json").write_text(json.dumps(content))
        run(configured(*words, f"path={tmp_path / 'transforms.json'}"))
    frame_counts = sorted(len(images(folder / "frames")) for folder in (tmp_path / "runs/video").iterdir())
    assert frame_counts == [1, 2]


def test_the_latest_splat_of_original_output_is_taken(tmp_path):
    from gaussian_enhancer.runs.splat_source import splat_file

    for step in (7000, 30000, 900):
        file = tmp_path / f"point_cloud/iteration_{step}/point_cloud.ply"
        file.parent.mkdir(parents=True)
        file.write_bytes(b"")
    assert splat_file(tmp_path).parent.name == "iteration_30000"


def test_a_video_that_was_rendered_elsewhere_is_enhanced_and_keeps_its_sound(sheet_run, bright, tmp_path, capsys):
    """Its frames take the place of the splat's renders; those without a camera stay as they are."""
    whole = tmp_path / "whole"
    common = f"run={sheet_run}", f"weights={bright}", f"runs={tmp_path / 'runs'}", "colour_clamping=0"
    path = tmp_path / "path.json"
    entries = [
        {"camera_to_world": (torch.linalg.inv(plane_camera(i, 48, 64).world_to_camera) @ FLIPPED).flatten().tolist()}
        | {"fov": 50, "aspect": 64 / 48}
        for i in range(3)
    ]
    path.write_text(json.dumps({"render_height": 48, "render_width": 64, "camera_path": entries}))
    run(configured(*common, f"path={path}", "layout=render", f"output={whole}", "format=frames"))
    renders = images(whole)
    shown = [(0.5 * image.permute(1, 2, 0) * 255).round().byte().numpy() for image in renders.values()]
    clip = write_clip(tmp_path / "clip.mp4", "aac", [*shown, shown[0], shown[1]])
    enhanced_video = tmp_path / "made.mp4"
    words = (*common, f"path={path}", f"input={clip}")
    capsys.readouterr()
    run(configured(*words, f"output={enhanced_video}"))
    assert "2 of 5 frames of the input have no camera and stay as they are" in capsys.readouterr().err
    assert heard(enhanced_video) == heard(clip)
    before, after = decoded(clip), decoded(enhanced_video)
    assert len(after) == 5
    changes = [float((b - a).mean()) for a, b in zip(before, after, strict=True)]
    assert min(changes[:3]) > 0.02
    assert max(map(abs, changes[3:])) < 0.01
    with av.open(str(enhanced_video)) as source:
        assert source.streams.video[0].average_rate == 10
    run(configured(*words, "format=frames", "layout=side_by_side", f"output={tmp_path / 'beside'}"))
    assert len(images(tmp_path / "beside")) == 5

    for extra, message in (
        (("frames=3",), "frames: is given, and the input states it"),
        (("path=orbit",), "give path=FILE"),
        ((f"input={tmp_path / 'none.mp4'}",), "does not exist"),
        (("format=webm", f"output={tmp_path / 'enhanced_video.webm'}"), "cannot hold sound in aac"),
        ((f"output={clip}",), "is the input itself"),
        (("format=frames", f"output={sheet_run / 'test/ours_100/gt'}"), "of the input; name another folder"),
    ):
        with pytest.raises(InputError, match=message):
            run(configured(*words, *extra))
    short = write_clip(tmp_path / "short.mp4", None, shown[:2])
    with pytest.raises(InputError, match="has 2 frames for 3 cameras"):
        run(configured(*words, f"input={short}"))
    square = write_clip(tmp_path / "square.mp4", None, [image[:, :48].copy() for image in shown])
    with pytest.raises(InputError, match="has frames of 48x48"):
        run(configured(*words, f"input={square}"))
