"""A fit from photos to folder: it learns, resumes, exports, refuses."""

import dataclasses
import math
from pathlib import Path

import pytest
import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.splat.fit import export
from gaussian_enhancer.splat.fit.densify import Densification
from gaussian_enhancer.splat.fit.fit import fit
from gaussian_enhancer.splat.fit.relocation import Relocation
from gaussian_enhancer.splat.io.ply import read_ply
from gaussian_enhancer.splat.methods import MipSplatting, ThreeDGS, TwoDGS
from gaussian_enhancer.types import Camera

HEIGHT, WIDTH, FOCAL = 24, 32, 30.0
QUICK = {
    "steps": 40,
    "start_gaussians": 300,
    "max_gaussians": 400,
    "progress": False,
    "densification": Densification(every=10),
}


def photo_of_plane(number: int, x: float) -> Photo:
    """A photo of the textured plane z = 4 by a camera at (x, 0, 0) turned towards its middle."""
    turn = -x / 4
    c, s = math.cos(turn), math.sin(turn)
    rotation = torch.tensor([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    pose = torch.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ torch.tensor([x, 0.0, 0.0])
    K = torch.tensor([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    v, u = torch.meshgrid(torch.arange(HEIGHT) + 0.5, torch.arange(WIDTH) + 0.5, indexing="ij")
    rays = torch.stack([u, v, torch.ones_like(u)], -1) @ torch.linalg.inv(K).T @ rotation
    hit = rays * (4.0 / rays[..., 2:])
    waves = [(3.0, 1.3, 0.2), (-2.1, 3.3, 1.0), (4.1, 2.7, 2.0)]
    pixels = torch.stack([0.5 + 0.4 * torch.sin(a * (x + hit[..., 0]) + b * hit[..., 1] + p) for a, b, p in waves])
    return Photo(f"view{number}.png", Camera(K, pose, HEIGHT, WIDTH), lambda: pixels)


@pytest.fixture(scope="module")
def scene() -> Scene:
    photos = tuple(photo_of_plane(i, x) for i, x in enumerate((-0.6, -0.3, 0.0, 0.3, 0.6)))
    return Scene("plane", photos, (0, 1, 3, 4), (2,))


def psnr_of(folder: Path) -> float:
    rendered = read_run(folder).targets[0]
    return -10 * torch.log10((rendered.read() - rendered.read_photo()).square().mean()).item()


@pytest.mark.parametrize("method", [ThreeDGS(), TwoDGS(), MipSplatting()], ids=lambda m: m.name)
def test_held_out_view_is_learnt_and_the_folder_reads_back(scene, tmp_path, method):
    gaussians = fit(scene, method, tmp_path, **QUICK | {"steps": 120}, snapshots=(0.5,))
    assert psnr_of(tmp_path) > 20.0
    assert run_steps(tmp_path) == (60, 120)
    rendered = read_run(tmp_path)
    assert len(rendered.references) == 4
    depth = rendered.targets[0].read_depth()
    assert depth[depth > 0].median().item() == pytest.approx(4.0, rel=0.15)
    assert torch.equal(rendered.targets[0].camera.K, scene.photos[2].camera.K)
    stored = read_ply(tmp_path / "splat.ply")
    torch.testing.assert_close(stored.means, gaussians.means)
    assert (stored.smoothing is not None) == isinstance(method, MipSplatting)
    assert not (tmp_path / "checkpoint.pt").exists()


@pytest.mark.parametrize(
    "densification", [Densification(every=10), Relocation(every=5)], ids=lambda d: type(d).__name__
)
def test_resumed_fit_equals_the_uninterrupted_one(scene, tmp_path, densification):
    quick = QUICK | {"densification": densification}
    whole = fit(scene, MipSplatting(), tmp_path / "whole", **quick)
    fit(scene, MipSplatting(), tmp_path / "parts", **quick, stop_after=13)
    assert (tmp_path / "parts/checkpoint.pt").is_file()
    assert not (tmp_path / "parts/splat.ply").exists()
    parts = fit(scene, MipSplatting(), tmp_path / "parts", **quick)
    for name, value in vars(whole).items():
        torch.testing.assert_close(vars(parts)[name], value, rtol=1e-4, atol=1e-5)


def test_checkpoint_of_another_fit_is_refused(scene, tmp_path):
    fit(scene, ThreeDGS(), tmp_path, **QUICK, stop_after=3)
    with pytest.raises(InputError, match="other settings"):
        fit(scene, ThreeDGS(), tmp_path, **QUICK, seed=1)


def test_damaged_checkpoint_is_refused(scene, tmp_path):
    (tmp_path / "checkpoint.pt").write_bytes(b"no checkpoint")
    with pytest.raises(InputError, match="cannot be read"):
        fit(scene, ThreeDGS(), tmp_path, **QUICK)


def test_full_disk_is_an_input_error_and_leaves_nothing_half_written(scene, tmp_path, monkeypatch):
    def refuse(path, content):
        path.write_text("half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", refuse)
    with pytest.raises(InputError, match="No space left"):
        fit(scene, ThreeDGS(), tmp_path, **QUICK, snapshots=())
    assert not list(tmp_path.rglob("*.npy"))
    assert not list(tmp_path.rglob(".*"))
    assert not (tmp_path / "splat.ply").exists()


def broken(scene: Scene, **change: object) -> Scene:
    photos = (dataclasses.replace(scene.photos[0], **change), *scene.photos[1:])
    return dataclasses.replace(scene, photos=photos)


def test_unusable_photos_are_refused_before_anything_is_written(scene, tmp_path):
    cases = {
        "not finite": broken(scene, read=lambda: torch.full((3, HEIGHT, WIDTH), torch.nan)),
        "32x23 but its camera is 32x24": broken(scene, read=lambda: torch.zeros(3, 23, 32)),
        "no camera": broken(scene, camera=None),
        "at least two photos": dataclasses.replace(scene, train=(0,)),
    }
    for message, case in cases.items():
        with pytest.raises(InputError, match=message):
            fit(case, ThreeDGS(), tmp_path, **QUICK)
    with pytest.raises(InputError, match="choose plane_sweep or random"):
        fit(scene, ThreeDGS(), tmp_path, **QUICK, init="points")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("background", [(0.25, 0.5, 1e-05), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)])
def test_the_folder_remembers_the_background(scene, tmp_path, background):
    fit(dataclasses.replace(scene, background=background), ThreeDGS(), tmp_path, **QUICK | {"steps": 3})
    assert read_run(tmp_path).background == background
    assert f"white_background={background == (1, 1, 1)}," in (tmp_path / "cfg_args").read_text()


def test_photos_that_differ_in_their_ending_only_are_refused(scene, tmp_path):
    twins = broken(scene, name="view1.jpg")
    with pytest.raises(InputError, match="ending only"):
        fit(twins, ThreeDGS(), tmp_path, **QUICK)


def test_export_moves_a_splat_once_where_the_device_gives_no_median_depth(scene, tmp_path, monkeypatch):
    gaussians = fit(scene, ThreeDGS(), tmp_path / "fit", **QUICK | {"steps": 3}, stop_after=3)
    export.export_views(tmp_path / "whole", scene, gaussians, ThreeDGS(), 3)
    moved, drawn, move = [], export.render, type(gaussians).to

    def without_median(given, *rest, **options):
        view = drawn(given, *rest, **options)
        return dataclasses.replace(view, median_depth=None) if given is gaussians else view

    def counted(one, *where):
        moved.append(where)
        return move(one, *where)

    monkeypatch.setattr(export, "render", without_median)
    monkeypatch.setattr(type(gaussians), "to", counted)
    export.export_views(tmp_path / "lacking", scene, gaussians, ThreeDGS(), 3)
    assert moved == [("cpu",)]
    written = sorted((tmp_path / "whole").rglob("*.*"))
    assert len(written) == 4 * len(scene.photos) + 1  # cameras.json
    for path in written:
        assert (tmp_path / "lacking" / path.relative_to(tmp_path / "whole")).read_bytes() == path.read_bytes()
