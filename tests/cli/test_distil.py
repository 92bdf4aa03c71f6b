"""The job distil on a small run of a textured plane, whose splat is a sheet of coloured Gaussians."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.cli.distil import run
from gaussian_enhancer.cli.enhance import run as enhance
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.metrics.records import read_records
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.runs import lock
from gaussian_enhancer.runs.compose import compose_job
from gaussian_enhancer.runs.enhancement import load_enhancement
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.splat.filters import filter_size
from gaussian_enhancer.splat.io.open import read_splat
from gaussian_enhancer.splat.io.ply import read_ply, write_ply
from gaussian_enhancer.types import Gaussians
from support.job_config import QUIET, job_config, run_job
from support.synthetic_runs import (
    coloured_sheet,
    copy_with_black_photos,
    copy_with_moved_splat,
    copy_with_splat,
    plane_camera,
)

STEPS = 40
CAMERAS = [plane_camera(index, 48, 64) for index in range(8)]


def configured(*overrides: str, job: str = "distil"):
    return job_config(job, *overrides, *QUIET)


def kinds() -> dict[str, Gaussians]:
    sheet = coloured_sheet(24)
    return {
        "3dgs": replace(sheet, sh=torch.cat([sheet.sh, torch.zeros(len(sheet), 3, 3)], 1)),
        "2dgs": replace(sheet, log_scales=sheet.log_scales[:, :2]),
        "mip_splatting": replace(sheet, smoothing=filter_size(sheet.means, CAMERAS)),
    }


@pytest.fixture(scope="module")
def fitted(plane_run, tmp_path_factory) -> Path:
    return copy_with_splat(plane_run, tmp_path_factory.mktemp("fitted") / "plane", kinds()["3dgs"])


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "sif.safetensors"
    torch.manual_seed(0)
    save_weights(path, SIF((8, 8, 8), (1, 1, 1)), ReferenceConfig(), {"strength": 1.0})
    return path


@pytest.fixture
def words(fitted, weights, tmp_path) -> tuple[str, ...]:
    few = f"settings.steps={STEPS}", "settings.views=3", "settings.fade=1"
    return f"run={fitted}", f"weights={weights}", f"runs={tmp_path / 'runs'}", *few


@pytest.mark.parametrize("kind", ["3dgs", "2dgs", "mip_splatting"])
def test_a_run_becomes_a_better_run_of_the_same_kind(plane_run, words, weights, tmp_path, kind, capsys):
    before = kinds()[kind]
    source = copy_with_splat(plane_run, tmp_path / "source", before)
    after = run(configured(*words, f"run={source}", f"output={tmp_path / 'better'}"))
    assert sorted(path.name for path in (tmp_path / "better").iterdir()) == sorted(
        ["cameras.json", "cfg_args", "config.yaml", "done", "records.jsonl", "rounds", "splat.ply", "test", "train"]
    )
    stored = read_ply(tmp_path / "better/splat.ply")
    assert stored.log_scales.shape == before.log_scales.shape
    assert stored.sh.shape == before.sh.shape
    assert (stored.smoothing is None) == (before.smoothing is None)
    assert run_steps(tmp_path / "better") == (0, STEPS)
    records = [record for record in read_records(tmp_path / "better/records.jsonl") if record.kind == "quality"]
    assert [record.splat for record in records] == [f"{kind}/0"] * 2 + [f"{kind}/{STEPS}"] * 2
    raw, distilled = (sum(record.metrics["psnr"] for record in half) / 2 for half in (records[:2], records[2:]))
    assert after == pytest.approx(distilled)
    assert distilled > raw + 0.1
    assert f"held-out PSNR {raw:.2f} -> {distilled:.2f} dB" in capsys.readouterr().err
    rendered = read_run(tmp_path / "better")
    assert (len(rendered.targets), len(rendered.references)) == (2, 6)
    enhance(configured(f"run={tmp_path / 'better'}", f"weights={weights}", f"output={tmp_path / 'out'}", job="enhance"))
    assert len(list((tmp_path / "out").glob("*.png"))) == 2


def test_enhance_distils_first_where_it_is_asked_to(fitted, weights, tmp_path, monkeypatch):
    settings = f"settings.steps={STEPS}", "settings.views=3"

    def quick(name, cfg, **values):
        return compose_job(name, cfg, (f"weights={weights}", *settings), **values)

    monkeypatch.setattr("gaussian_enhancer.cli.enhance.compose_job", quick)
    overrides = f"run={fitted}", f"weights={weights}", f"runs={tmp_path / 'runs'}", "distil=true"

    def started(*extra: str) -> None:
        run_job(enhance, configured(*overrides, *extra, job="enhance"))

    started(f"output={tmp_path / 'once'}")
    (distilled_run,) = (tmp_path / "runs/distil").iterdir()
    assert (distilled_run / "done").is_file()
    started(f"run={distilled_run}", "distil=false", f"output={tmp_path / 'twice'}")
    monkeypatch.setattr("gaussian_enhancer.distil.task.distil", lambda *_, **__: pytest.fail("was made again"))

    def load_unlocked(*arguments, **options):
        assert not (distilled_run / lock.NAME).exists()  # another process may use the splat during the enhancement
        return load_enhancement(*arguments, **options)

    monkeypatch.setattr("gaussian_enhancer.cli.enhance.load_enhancement", load_unlocked)
    started(f"output={tmp_path / 'again'}")
    names = sorted(path.name for path in (tmp_path / "once").iterdir())
    assert len(names) == 2
    for name in names:
        assert len({(tmp_path / folder / name).read_bytes() for folder in ("once", "twice", "again")}) == 1
    for extra, message in (
        ("dry_run=true", "dry_run: comes with distil=true"),
        ("step=3", "step: comes with distil=true"),
        ("run=null", "distil: is asked for without a splat"),
    ):
        with pytest.raises(InputError, match=message):
            started(extra)


def test_the_same_command_finds_the_finished_run(words, tmp_path, monkeypatch):
    first = run(configured(*words))
    monkeypatch.setattr("gaussian_enhancer.distil.task.distil", lambda *_, **__: pytest.fail("was made again"))
    assert run(configured(*words)) == first
    assert len(list((tmp_path / "runs/distil").iterdir())) == 1


def test_held_out_photos_change_nothing_but_the_measurement(fitted, words, tmp_path):
    changed_run = tmp_path / "changed_run"
    shutil.copytree(fitted, changed_run)
    for path in (changed_run / "test").rglob("*.png"):
        size = Image.open(path).size
        noise = np.random.default_rng(0).integers(0, 255, (size[1], size[0], 3), np.uint8)
        Image.fromarray(noise if path.parent.name != "alpha" else noise[..., 0]).save(path)
    one = run(configured(*words, f"output={tmp_path / 'one'}"))
    two = run(configured(*words, f"run={changed_run}", f"output={tmp_path / 'two'}"))
    assert (tmp_path / "one/splat.ply").read_bytes() == (tmp_path / "two/splat.ply").read_bytes()
    assert one != two


def test_original_3dgs_output_whose_sides_are_both_numbered_from_0(fitted, words, tmp_path):
    source, cameras = tmp_path / "original", json.loads((fitted / "cameras.json").read_text())
    ordered = sorted(cameras, key=lambda view: (view["split"] != "test", view["img_name"]))
    counts = {"test": 0, "train": 0}
    for entry in ordered:
        side, stem = entry["split"], Path(entry["img_name"]).stem
        for subfolder in ("renders", "gt"):
            place = source / side / "ours_100" / subfolder / f"{counts[side]:05d}.png"
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(fitted / side / "ours_100" / subfolder / f"{stem}.png", place)
        counts[side] += 1
    entries = [{key: value for key, value in entry.items() if key != "split"} for entry in ordered]
    (source / "cameras.json").write_text(json.dumps(entries))
    write_ply(source / "point_cloud/iteration_100/point_cloud.ply", kinds()["3dgs"])
    assert run(configured(*words, f"run={source}", f"output={tmp_path / 'better'}")) > 0
    rendered = read_run(tmp_path / "better")
    assert [view.name for view in rendered.targets] == ["00000.png", "00001.png"]
    assert len(rendered.references) == 6


@pytest.mark.parametrize(("name", "file"), [("compressed", "splat.compressed.ply"), ("spz", "splat.spz")])
def test_a_small_file_beside_the_splat(words, tmp_path, name, file):
    pytest.importorskip("gsply", reason="gsply is in the dependency group `test`")
    run(configured(*words, f"format={name}", "settings.share=0", "settings.steps=3", f"output={tmp_path / 'small'}"))
    small, whole = (read_splat(tmp_path / "small" / splat_name) for splat_name in (file, "splat.ply"))
    assert len(small) == len(whole)
    assert (tmp_path / "small" / file).stat().st_size < 0.6 * (tmp_path / "small/splat.ply").stat().st_size


def test_a_splat_and_its_capture(fitted, words, tmp_path, monkeypatch):
    photos = tuple(
        Photo(view.name, plane_camera(index, 48, 64), view.read_photo)  # type: ignore[arg-type]
        for index, view in enumerate(read_run(fitted).references)
    )
    capture = Scene("capture", photos, tuple(range(len(photos))), ())
    monkeypatch.setattr("gaussian_enhancer.distil.task.build", patched_build(capture))
    overrides = f"gaussians={fitted / 'splat.ply'}", "run=null", "scene=capture", "scene.path=x"
    assert run(configured(*words, *overrides, f"output={tmp_path / 'better'}")) is None
    assert read_ply(tmp_path / "better/splat.ply").sh.shape == (576, 4, 3)
    assert not (tmp_path / "better/test").exists()


def patched_build(capture: Scene):
    from gaussian_enhancer.runs.instantiate import build

    return lambda node: capture if "open_capture" in str(node.get("_target_")) else build(node)


def test_a_splat_outside_the_training_views_is_refused(fitted, words, tmp_path):
    moved = copy_with_moved_splat(fitted, tmp_path / "moved")
    with pytest.raises(InputError, match=r"splat\.ply: has no Gaussian in any view of moved"):
        run(configured(*words, f"run={moved}", f"output={tmp_path / 'better'}"))
    assert not (tmp_path / "better").exists()


def test_a_splat_unlike_its_photos_is_distilled_with_a_warning(fitted, words, tmp_path, capsys):
    other = copy_with_black_photos(fitted, tmp_path / "other")
    run(configured(*words))
    assert "WARNING" not in capsys.readouterr().err
    run(configured(*words, f"run={other}"))
    assert "WARNING: the splat's renders are unlike their photos" in capsys.readouterr().err


def test_pruning_alone_needs_no_weights_and_takes_the_floater(fitted, words, tmp_path, capsys):
    clean = read_ply(fitted / "splat.ply")
    floater = replace(
        clean[torch.arange(1)], means=torch.tensor([[0.0, 0.0, 1.5]]), log_scales=torch.full((1, 3), 0.05).log()
    )
    joined = {
        name: torch.cat([value, getattr(floater, name)]) for name, value in vars(clean).items() if value is not None
    }
    renders = tmp_path / "spoilt"
    shutil.copytree(fitted, renders)
    for view in (*read_run(fitted).targets, *read_run(fitted).references):  # photos of the sheet itself
        (photo,) = renders.glob(f"*/ours_100/gt/{view.name}")
        save_render(photo, clean, view.camera)
    write_ply(renders / "splat.ply", Gaussians(**joined))
    after = run(
        configured(*words, f"run={renders}", "prune_only=true", "weights=none_such", f"output={tmp_path / 'less'}")
    )
    assert "1 of 577 Gaussians removed as floaters" in capsys.readouterr().err
    assert len(read_ply(tmp_path / "less/splat.ply")) == 576
    assert torch.equal(read_ply(tmp_path / "less/splat.ply").means, clean.means)
    assert run_steps(tmp_path / "less") == (0, 1)
    assert after > 40


def save_render(path: Path, gaussians: Gaussians, camera) -> None:
    from gaussian_enhancer.scene.image_files import write_image
    from gaussian_enhancer.splat.methods import ThreeDGS
    from gaussian_enhancer.splat.render import render

    write_image(path, render(gaussians, camera, ThreeDGS()).colour)
