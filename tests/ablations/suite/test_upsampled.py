"""Images 4 times as fine as a fit's renders, and the table that compares them, on a tiny procedural scene."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from omegaconf import DictConfig, OmegaConf, open_dict

from ablations.jobs import quality
from ablations.suite import upsampled as upsampled
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.cli import pipeline
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.metrics.records import read_records
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.run import open_run
from gaussian_enhancer.scene.cameras import write_scene_cameras
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.photos import read_photo
from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.splat.io.ply import read_ply, write_ply
from gaussian_enhancer.splat.methods import ThreeDGS
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.types import Gaussians
from support.job_config import job_config, run_job

SMALL = ["scene=object", "scene.seed=2000", "scene.height=24", "scene.width=32", "scene.views=9", "+scene.points=0"]


def write_fit(folder: Path, scene: Scene) -> None:
    """What a fit leaves behind: photos, smoothed photos as renders, a splat of random blobs."""
    for side, photos in (("test", scene.test_photos), ("train", scene.train_photos)):
        for photo in photos:
            part, image = folder / side / "ours_1000", photo.read()
            write_image(part / "gt" / photo.name, image)
            write_image(part / "renders" / photo.name, F.avg_pool2d(image[None], 3, 1, 1, count_include_pad=False)[0])
    write_scene_cameras(folder / "cameras.json", scene)
    generator = torch.Generator().manual_seed(0)
    means = torch.rand(300, 3, generator=generator) - 0.5
    round_ = torch.tensor([1.0, 0, 0, 0]).repeat(300, 1)
    colours = torch.rand(300, 1, 3, generator=generator)
    write_ply(
        folder / "splat.ply",
        Gaussians(means, torch.full((300, 3), -3.0), round_, torch.full((300,), 3.0), colours),
    )


@pytest.fixture
def fits(monkeypatch) -> list[Scene]:
    """Fitting replaced by `write_fit`; the scenes that were fitted."""
    made: list[Scene] = []

    def fit(job: DictConfig) -> None:
        made.append(build(job.scene))
        run = open_run(job, "fit", "object_0-3dgs")
        write_fit(run.folder, made[-1])
        run.finish()

    monkeypatch.setattr(pipeline.fit, "run", fit)
    return made


@pytest.fixture
def configured(tmp_path) -> Callable[..., DictConfig]:
    """The job's configuration with its second table alone, for one small scene."""

    def of(**methods: dict[str, object]) -> DictConfig:
        paths = [f"runs={tmp_path / 'runs'}", f"markdown={tmp_path / 'q.md'}", f"records={tmp_path / 'q.jsonl'}"]
        few = ["scenes=[object]", "splats=[3dgs]", "lpips=[]", "backbones=null", "~tables.lr", "runtime.threads=1"]
        cfg = job_config("quality", *paths, *few, "runtime.progress=false")
        with open_dict(cfg):
            cfg.groups.procedural.scenes = {"object": SMALL}
            cfg.tables.sr.every = 1
            cfg.tables.sr.methods = {"bicubic": {"upscale": True}, **methods}
        return cfg

    return of


def test_bicubic_enlarges_each_image_once_and_keeps_what_is_even(tmp_path, monkeypatch) -> None:
    write_image(tmp_path / "in/even.png", torch.full((3, 5, 7), 0.2))
    ramp = torch.linspace(0.2, 0.8, 16).expand(3, 8, 16)
    write_image(tmp_path / "in/ramp.png", ramp)
    cfg = OmegaConf.create({"runs": str(tmp_path / "runs")})
    write_image(tmp_path / "photos/even.png", torch.full((3, 21, 27), 0.5))
    write_image(tmp_path / "photos/ramp.png", torch.full((3, 32, 64), 0.5))
    folder = upsampled.bicubic(cfg, tmp_path / "in", "a", tmp_path / "photos")
    even, grown = read_photo(folder / "even.png"), read_photo(folder / "ramp.png")
    assert even.shape == (3, 21, 27)  # of its photo, which rounding made miss 4 times the image's
    assert torch.equal(even, torch.full_like(even, 51 / 255))
    between = (torch.arange(64) + 0.5) / 4 - 0.5  # where the fine grid's pixels lie on the coarse one
    expected = 0.2 + 0.6 * between / 15
    assert torch.allclose(grown[0, 16, 8:-8], expected[8:-8], atol=2.5 / 255)
    monkeypatch.setattr(upsampled, "upsample_bicubic", lambda *_: pytest.fail("done before"))
    assert upsampled.bicubic(cfg, tmp_path / "in", "a", tmp_path / "photos") == folder


@pytest.mark.slow
def test_the_table_measures_enlarged_and_rendered_images_against_fine_photos(fits, configured, tmp_path) -> None:
    torch.manual_seed(0)
    save_weights(tmp_path / "w.safetensors", SIF((8, 8), (1, 1)), ReferenceConfig(), {})
    weights = str(tmp_path / "w.safetensors")
    run_job(
        quality.run,
        configured(
            same_bicubic={"role": "other", "weights": weights, "upscale": True},
            render_4x={"role": "other", "render": True},
            render_4x_same={"role": "ours", "weights": weights, "render": True},
            too_small={"role": "other", "weights": weights},
        ),
    )
    (scene,) = fits
    records = {(r.variant, r.view): r for r in read_records(tmp_path / "q.jsonl")}
    names = [photo.name for photo in scene.test_photos]
    assert len(names) == 2
    runs = tmp_path / "runs"
    (fit,) = (runs / "fit").iterdir()
    for photo in scene.test_photos:
        method = {name: records[f"sr/{name}", photo.name] for name in ("bicubic", "render_4x")}
        assert {record.size for record in method.values()} == {(128, 96)}
        # A network that was never trained changes nothing, before and after enlarging.
        assert records["sr/same_bicubic", photo.name].metrics == method["bicubic"].metrics
        assert records["sr/render_4x_same", photo.name].metrics == method["render_4x"].metrics
        (drawn,) = runs.glob(f"render_finer/*/images/{photo.name}")
        assert photo.camera is not None
        camera = photo.camera.resized(96, 128)
        expected = render(read_ply(fit / "splat.ply"), camera, ThreeDGS(), scene.background).colour
        assert (read_photo(drawn) - expected.detach()).abs().max() < 0.01
        (fine,) = runs.glob(f"fine_photos/*/images/{photo.name}")
        shrunk = F.avg_pool2d(read_photo(fine)[None], 4)[0]
        assert (shrunk - photo.read()).abs().mean() < 0.02
    page = (tmp_path / "q.md").read_text(encoding="utf-8")
    assert "is 32x24" in page.split("### Missing")[1]
    assert "| object | too_small | 0 of 1 | missing" in page


@pytest.mark.slow
def test_rows_at_four_times_the_resolution_are_found_again(fits, configured, monkeypatch, tmp_path) -> None:
    methods = {"render_4x": {"role": "other", "render": True}}
    run_job(quality.run, configured(**methods))
    page = (tmp_path / "q.md").read_text(encoding="utf-8")
    monkeypatch.setattr(upsampled, "write_image", lambda *_: pytest.fail("done before"))
    monkeypatch.setattr(upsampled, "render_capture", lambda *_: pytest.fail("done before"))
    run_job(quality.run, configured(**methods))
    assert (tmp_path / "q.md").read_text(encoding="utf-8") == page
    assert len(fits) == 1
