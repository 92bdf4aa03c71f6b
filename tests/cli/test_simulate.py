"""The job ``simulate``: from a photo or a run to samples, sheets and a page."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gaussian_enhancer.cli import simulate
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.adaptive import AdaptiveGate
from gaussian_enhancer.degrade.gates.gate import ArtefactStep, RandomGate
from gaussian_enhancer.degrade.generative.second_stage import FactorDesign, FactorModel
from gaussian_enhancer.degrade.generative.weights import save_model
from gaussian_enhancer.degrade.photographed import read_held_out, read_image
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.photos import read_coverage, read_photo
from gaussian_enhancer.scene.renders import read_run
from support.job_config import job_config


def job(folder: Path, *overrides: str) -> Path:
    quick = ["draws=3", "runtime.threads=1", "runtime.progress=false", f"output={folder}"]
    cfg = job_config("simulate", *quick, *overrides)
    simulate.run(cfg)
    return folder


def samples(folder: Path) -> list[dict]:
    return json.loads((folder / "simulation.json").read_text())["samples"]


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture)


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    values = np.random.default_rng(0).integers(0, 256, (20, 28, 3), dtype=np.uint8)
    Image.fromarray(values).save(tmp_path / "photo.png")
    return tmp_path / "photo.png"


def test_samples_are_what_their_record_says(photo: Path, tmp_path: Path) -> None:
    folder = job(tmp_path / "out", f"image={photo}", "gate=random", "seed=4")
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    sheets = {"types.png", "gates.png", "simulation.html", "simulation.json", "config.yaml", "done"}
    assert names == sheets | {f"samples/{i:03d}.png" for i in range(3)}
    view = View(read_photo(photo)[None])
    for sample in samples(folder):
        again = Simulator(RandomGate())(view, [torch.Generator().manual_seed(sample["seed"])])
        assert torch.equal(read_photo(folder / sample["file"]), again.image[0])
        drawn = RandomGate().draw(torch.Generator().manual_seed(sample["seed"]))
        assert tuple(ArtefactStep(**step) for step in sample["steps"]) == drawn


def test_the_first_samples_do_not_depend_on_their_number_and_do_on_the_seed(photo: Path, tmp_path: Path) -> None:
    few = samples(job(tmp_path / "a", f"image={photo}"))
    many = samples(job(tmp_path / "b", f"image={photo}", "draws=5"))
    other = samples(job(tmp_path / "c", f"image={photo}", "seed=1"))
    assert many[:3] == few
    assert not {sample["seed"] for sample in few} & {sample["seed"] for sample in other}


def test_a_type_is_switched_off_from_the_command_line(photo: Path, tmp_path: Path) -> None:
    on = samples(job(tmp_path / "on", f"image={photo}", "gate=all"))
    off = samples(job(tmp_path / "off", f"image={photo}", "gate=all", "gate.types.needle=false"))
    for with_it, without in zip(on, off, strict=True):
        assert "needle" in [step["type"] for step in with_it["steps"]]
        assert without["steps"] == [step for step in with_it["steps"] if step["type"] != "needle"]


def test_without_a_gate_the_photo_comes_back(photo: Path, tmp_path: Path) -> None:
    folder = job(tmp_path / "out", f"image={photo}", "gate=none")
    assert (pixels(folder / "samples/000.png") == pixels(photo)).all()
    assert "generator=none" in (folder / "simulation.html").read_text()
    assert not (folder / "generator.png").exists()


def test_a_gate_that_cannot_be_drawn_is_named(photo: Path, tmp_path: Path) -> None:
    page = (job(tmp_path / "out", f"image={photo}") / "simulation.html").read_text()
    assert "a single photo has no training views to calibrate it on" in page


def test_depth_and_opacity_are_kept(photo: Path, tmp_path: Path) -> None:
    transparent = tmp_path / "rgba.png"
    alpha = np.zeros((20, 28), np.uint8)
    alpha[:, 10:] = 200
    Image.fromarray(np.dstack([pixels(photo), alpha])).save(transparent)
    z = np.full((20, 28), 3000, np.uint16)
    Image.fromarray(z).save(tmp_path / "z.png")
    words = (f"image={transparent}", f"depth={tmp_path / 'z.png'}", "depth_scale=0.001", "background=[1,1,1]")
    folder = job(tmp_path / "out", *words, "gate=none")
    assert np.load(folder / "samples/000_depth.npy") == pytest.approx(np.full((20, 28), 3.0))
    assert torch.equal(read_coverage(folder / "samples/000_alpha.png"), read_coverage(transparent))
    assert (pixels(folder / "samples/000.png")[:, :10] == 255).all()
    assert (folder / "types_depth.png").is_file()


@pytest.mark.parametrize(
    "values",
    [
        np.full((1, 1, 3), 90, np.uint8),
        np.full((16, 24, 3), 255, np.uint8),
        np.zeros((16, 24), np.uint8),
        np.arange(384, dtype=np.uint16).reshape(16, 24) * 170,
        np.full((1, 40, 4), 128, np.uint8),
    ],
    ids=["one pixel", "white", "black grey", "16 bit", "a transparent line"],
)
def test_odd_images_pass(tmp_path: Path, values: np.ndarray) -> None:
    Image.fromarray(values).save(tmp_path / "odd.png")
    folder = job(tmp_path / "out", f"image={tmp_path / 'odd.png'}", "gate=all", "draws=1")
    assert pixels(folder / "samples/000.png").shape[:2] == values.shape[:2]


def test_sixteen_bits_are_read_as_such(tmp_path: Path) -> None:
    Image.fromarray(np.full((4, 4), 32896, np.uint16)).save(tmp_path / "deep.png")
    assert read_image(tmp_path / "deep.png").view.image.unique().tolist() == pytest.approx([32896 / 65535])


def test_a_run_gives_photo_depth_opacity_and_render(plane_run: Path) -> None:
    target = read_run(plane_run).targets[1]
    for name in (target.name, Path(target.name).stem):
        photo = read_held_out(read_run(plane_run), name)
        assert torch.equal(photo.view.image[0], target.read_photo())
        assert torch.equal(photo.view.depth[0], target.read_depth())
        assert torch.equal(photo.view.alpha[0], target.read_alpha())
        assert torch.equal(photo.real[0], target.read())


def test_a_run_is_simulated_and_its_fingerprint_kept(plane_run: Path, tmp_path: Path) -> None:
    folder = job(tmp_path / "out", f"run={plane_run}", "view=view_004", "draws=1")
    record = json.loads((folder / "simulation.json").read_text())
    assert record["fingerprint"]["views"] == 6
    assert record["fingerprint"] == json.loads((folder / "fingerprint.json").read_text())
    assert (folder / "samples/000_depth.npy").is_file()
    assert "view_004.png" in (folder / "simulation.html").read_text()


@pytest.mark.slow
def test_the_adaptive_gate_is_calibrated_on_the_run(plane_run: Path, tmp_path: Path) -> None:
    folder = job(tmp_path / "out", f"run={plane_run}", "gate=adaptive", "gate.types.blur=false")
    gate = AdaptiveGate.from_file(folder / "gate.json")
    assert "blur" not in gate.chances
    assert sum(gate.chances.values()) > 0
    for sample in samples(folder):
        drawn = gate.draw(torch.Generator().manual_seed(sample["seed"]))
        assert tuple(ArtefactStep(**step) for step in sample["steps"]) == drawn
    again = job(
        tmp_path / "again",
        f"image={next((plane_run / 'test/ours_100/gt').iterdir())}",
        "gate=adaptive",
        f"gate.file={folder / 'gate.json'}",
    )
    assert samples(again) == samples(folder)


def test_stage_two_is_shown_beside_the_real_render(
    plane_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real_renders = []

    class Generator:
        def __call__(self, manual, generators, real=None):
            real_renders.append(real)
            return View(manual.image / 2, manual.depth, manual.alpha)

    build = simulate.build
    monkeypatch.setattr(simulate, "build", lambda node: Generator() if "NoSecond" in node._target_ else build(node))
    folder = job(tmp_path / "out", f"run={plane_run}", "gate=none", "draws=1")
    target = read_run(plane_run).targets[0]
    assert all(torch.equal(real[0], target.read()) for real in real_renders)
    halves = target.read_photo() / 2
    assert (read_photo(folder / "samples/000.png") - halves).abs().max() < 1 / 255
    assert (folder / "generator.png").is_file()


@pytest.mark.parametrize("kind", ["paired", "diffused"])
def test_learnt_generators_are_drawn(plane_run: Path, photo: Path, tmp_path: Path, kind: str) -> None:
    torch.manual_seed(0)
    model = FactorModel(FactorDesign(vector=4, grid=2, widths=(8, 8), code_width=8, code_blocks=1))
    torch.nn.init.normal_(model.combiner.head.weight, std=0.02)
    save_model(tmp_path / "g.safetensors", model, {})
    words = ("gate=none", f"generator={kind}", f"generator.weights={tmp_path / 'g.safetensors'}", "draws=2")
    folder = job(tmp_path / "out", f"run={plane_run}", *words)
    first, second = (pixels(folder / f"samples/{i:03d}.png").astype(int) for i in range(2))
    assert np.abs(first - second).max() > 0, "stage 2 does not depend on its seed"
    assert (folder / "generator.png").is_file()
    if kind == "paired":
        with pytest.raises(InputError, match="got no real renders"):
            job(tmp_path / "refused", f"image={photo}", *words)
        assert not (tmp_path / "refused").exists()


def test_refuses_what_does_not_go_together(photo: Path, plane_run: Path, tmp_path: Path) -> None:
    for words, message in {
        (): "nothing to simulate from",
        (f"image={photo}", f"run={plane_run}"): "image and run",
        (f"image={photo}", "view=a"): "view: was given beside image",
        (f"run={plane_run}", "depth=a.npy"): "depth: was given beside run",
        (f"run={plane_run}", "view=nowhere"): "view: is 'nowhere'",
        (f"image={photo}", "gate=adaptive"): "gate.file: is mandatory",
    }.items():
        with pytest.raises(InputError, match=message):
            job(tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()
